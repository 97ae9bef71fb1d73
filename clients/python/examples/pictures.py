"""A profile, a viewshed and a mesh as pictures: profile.png, viewshed.png, mesh.png. Needs sightline[plot].

    python pictures.py [ADDRESS]
"""

import sys

import sightline
from sightline import Pose, Settings, plot

with sightline.connect(sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1:7410") as server:
    terrain = server.terrain()
    a, b = (terrain.nx // 4, terrain.ny // 4, 20.0), (3 * terrain.nx // 4, 3 * terrain.ny // 4, 20.0)
    ends = server.line_of_sight(a, b, frame="grid", altitude="agl").ends
    ground = server.profile(a[:2], b[:2], frame="grid")
    drawn = plot.profile(ground, terrain, line_z=(ends[0][2], ends[1][2]))
    drawn.figure.savefig("profile.png", dpi=120)

    seen = server.viewshed(a, radius_m=5_000, frame="grid", altitude="agl")
    plot.viewshed(seen).figure.savefig("viewshed.png", dpi=120)

    above = terrain.scene_from_grid((terrain.nx / 2, terrain.ny / 8, terrain.heights[1])) + (0, 0, 2_000)
    pose = Pose.looking(above, terrain.scene_from_grid((terrain.nx / 2, terrain.ny / 2, terrain.heights[0])))
    with server.view(pose, Settings(triangles=3_000)) as view:
        view.frame()
        plot.scene(view.scene).figure.savefig("mesh.png", dpi=120)
