"""Run by Blender's Python: import a file, go to frames, and save what Blender then has.

Arguments: the file, the frames a second, frames separated by commas, the .npz file to make.
"""

import sys

import bpy
import numpy as np

source, fps, frames, target = sys.argv[-4:]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = int(fps)  # before importing: keyframes are placed by it
if source.endswith(".glb"):
    bpy.ops.import_scene.gltf(filepath=source)
elif source.endswith(".ply"):
    bpy.ops.wm.ply_import(filepath=source, forward_axis="NEGATIVE_Z", up_axis="Y")
elif source.endswith(".obj"):
    bpy.ops.wm.obj_import(filepath=source)
else:
    bpy.ops.wm.usd_import(filepath=source)

found = {"points": [], "cameras": [], "ortho_scale": [], "lens": []}
for frame in map(float, frames.split(",")):
    scene.frame_set(int(frame // 1), subframe=frame % 1)
    graph = bpy.context.evaluated_depsgraph_get()
    for thing in scene.objects:
        seen = thing.evaluated_get(graph)
        matrix = np.array(seen.matrix_world)
        if thing.type in ("MESH", "POINTCLOUD"):
            vertices = seen.data.vertices if thing.type == "MESH" else seen.data.points
            places = np.empty(3 * len(vertices), dtype=np.float32)
            vertices.foreach_get("co", places)
            found["points"].append(places.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
        elif thing.type == "CAMERA":
            matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
            found["cameras"].append(matrix)
            found["ortho_scale"].append(seen.data.ortho_scale)
            found["lens"].append((seen.data.lens, seen.data.sensor_width, seen.data.sensor_height))
for thing in scene.objects:
    if thing.type == "MESH":
        found["polygons"] = len(thing.data.polygons)
        found["colours"] = [attribute.name for attribute in thing.data.color_attributes]
np.savez(target, **{name: np.array(values) for name, values in found.items()})
