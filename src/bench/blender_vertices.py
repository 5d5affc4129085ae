"""Opens a scene by its own script and writes where Blender's camera sees the points of `points.json`, px:

    blender -b -P blender_vertices.py -- FOLDER
"""
import json
import os
import runpy
import sys

import bpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

folder = sys.argv[sys.argv.index("--") + 1]
runpy.run_path(os.path.join(folder, "open_in_blender.py"))
scene = bpy.context.scene
bpy.context.view_layer.update()
width, height = scene.render.resolution_x, scene.render.resolution_y
seen = []
for x, y, z in json.load(open(os.path.join(folder, "points.json"))):
    # +Y is up in the file, +Z in Blender.
    at = world_to_camera_view(scene, scene.camera, Vector((x, -z, y)))
    seen.append([at.x * width, (1 - at.y) * height])
# All corners of all meshes, too: what was imported is where it should be.
corners = [o.matrix_world @ v.co for o in bpy.data.objects if o.type == "MESH" for v in o.data.vertices]
json.dump({"seen": seen, "corners": [[c.x, c.z, -c.y] for c in corners]}, open(os.path.join(folder, "seen.json"), "w"))
