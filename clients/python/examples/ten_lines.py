import sightline

with sightline.connect("127.0.0.1:7410") as server:
    observer, target = (80, 60, 2), (300, 200, 2)  # posts east, posts north, metres above the ground
    answer = server.line_of_sight(observer, target, frame="grid", altitude="agl", derive=True)
    print(answer.verdict.name, answer.first_from_a)
    pose = sightline.Pose.looking((0, 0, 3000), (9000, 6000, 0))
    with server.view(pose, sightline.Settings(triangles=5000)) as view:
        print(view.frame())
        print(view.scene.mesh.vertices().shape, view.scene.mesh.triangles().shape)
        print(sightline.verdict_on_mesh(view.scene.mesh, *answer.ends).name)
