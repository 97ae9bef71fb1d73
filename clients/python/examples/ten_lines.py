"""A verdict and a mesh in ten lines. Start a server first: sightline demo, or sightline serve DB."""

import sightline

with sightline.connect("127.0.0.1:7410") as server:
    terrain = server.terrain()
    a, b = (10, 10, 2), (terrain.nx - 10, terrain.ny - 10, 2)  # 2 m above the ground at two posts
    answer = server.line_of_sight(a, b, frame="grid", altitude="agl", derive=True)
    print(answer.verdict.name, answer.first_from_a)
    pose = sightline.Pose.looking((0, 0, 3000), terrain.scene_from_grid(b))
    with server.view(pose, sightline.Settings(triangles=5000)) as view:
        print(view.frame())
        print(view.scene.mesh.vertices().shape, view.scene.mesh.triangles().shape)
        print(sightline.verdict_on_mesh(view.scene.mesh, *answer.ends).name)
