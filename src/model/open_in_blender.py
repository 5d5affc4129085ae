"""Opens the scene beside this file in Blender as the photographs show it:

    blender --python open_in_blender.py

glTF knows neither the size of a picture nor a principal point off its middle nor non-square pixels, so that a plain import looks
wrong; they are in the file all the same (`extras` of each camera). Here the first camera becomes the scene's, the picture gets its
size, the lens its shift, and the photograph stands behind it all. Distortion is left out: Blender has none of this kind.
"""
import os

import bpy
import numpy

# Importers of glTF up to Blender 3.4 use a name that numpy dropped.
if not hasattr(numpy, "bool"):
    numpy.bool = bool

HERE = os.path.dirname(os.path.abspath(__file__))


def fit(scene, camera):
    """Makes `camera` the scene's, its picture as large as the photograph was."""
    width, height = (int(v) for v in camera["size_px"])
    (fx, fy), (cx, cy) = camera["focal_px"], camera["principal_point_px"]
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100
    # Blender takes no aspect below 1.
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = max(1, fy / fx), max(1, fx / fy)
    lens = camera.data
    lens.sensor_fit = "HORIZONTAL"
    lens.lens = fx / width * lens.sensor_width
    # In widths of the picture.
    lens.shift_x = (width / 2 - cx) / width
    lens.shift_y = (cy - height / 2) / width * fx / fy


def behind(camera):
    """The photograph behind the scene."""
    path = os.path.join(HERE, camera["picture"])
    if not os.path.exists(path):
        print(f"{path} is not there: no picture behind the camera")
        return
    shown = camera.data.background_images.new()
    shown.image = bpy.data.images.load(path)
    shown.alpha, shown.display_depth, shown.frame_method = 1, "BACK", "STRETCH"
    camera.data.show_background_images = True


def open_scene(path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=path)
    cameras = [o for o in bpy.data.objects if o.type == "CAMERA" and "size_px" in o]
    # The last one fitted is the scene's.
    for camera in sorted(cameras, key=lambda c: c["is_plate"]):
        fit(bpy.context.scene, camera)
        if "picture" in camera:
            behind(camera)
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.spaces[0].region_3d.view_perspective = "CAMERA"


open_scene(os.path.join(HERE, "scene.glb"))
