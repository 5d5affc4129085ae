"""Irradiance volume by plain ray casting in Mitsuba: harmonics of radiance at points, by more and more rays until an error is
reached or the time is up. Arguments: folder with vertices, triangles, normals, radiance, points, reference (npy), the error, and
seconds. Prints a line for each number of rays: rays, seconds, relative RMS error of irradiance in harmonics."""
import sys
import time

import numpy as np

import mitsuba as mi

mi.set_variant("llvm_ad_rgb")
import drjit as dr  # noqa: E402

folder, wanted, limit = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
load = lambda name: np.load(f"{folder}/{name}.npy")
vertices, triangles, normals, radiance, points, reference = map(
    load, ["vertices", "triangles", "normals", "radiance", "points", "reference"])
mesh = mi.Mesh("room", len(vertices), len(triangles))
params = mi.traverse(mesh)
params["vertex_positions"] = vertices.astype(np.float32).ravel()
params["faces"] = triangles.astype(np.uint32).ravel()
params.update()
scene = mi.load_dict({"type": "scene", "room": mesh})
light = [mi.Float(radiance[:, k].astype(np.float32)) for k in range(3)]
front = [mi.Float(normals[:, k].astype(np.float32)) for k in range(3)]
PI = np.pi
reference = reference.reshape(len(points), 9, 3)
cosine = np.array([PI] + 3 * [2 * PI / 3] + 5 * [PI / 4])[None, :, None]
AT_ONCE = 1 << 22


def basis(d):
    x, y, z = d.x, d.y, d.z
    return [mi.Float(0.2820948), 0.4886025 * y, 0.4886025 * z, 0.4886025 * x, 1.0925484 * x * y, 1.0925484 * y * z,
            0.31539157 * (3 * z * z - 1), 1.0925484 * x * z, 0.5462742 * (x * x - y * y)]


def volume(rays):
    made = np.zeros((len(points), 9, 3), np.float32)
    some = max(1, AT_ONCE // rays)
    for first in range(0, len(points), some):
        part = points[first:first + some].astype(np.float32)
        n = len(part)
        index = dr.arange(mi.UInt32, n * rays)
        ray, point = index % rays, index // rays
        # The same even directions at each point (Fibonacci lattice): better than random ones.
        y = 1 - (2 * mi.Float(ray) + 1) / rays
        turn = mi.Float64(ray) * 0.6180339887498949
        angle = mi.Float(2 * PI * (turn - dr.floor(turn)))
        r = dr.sqrt(dr.abs(1 - y * y))
        d = mi.Vector3f(r * dr.cos(angle), y, r * dr.sin(angle))
        at = mi.Point3f(*[dr.gather(mi.Float, mi.Float(part[:, k]), point) for k in range(3)])
        hit = scene.ray_intersect_preliminary(mi.Ray3f(at, d))
        valid = hit.is_valid()
        normal = mi.Vector3f(*[dr.gather(mi.Float, f, hit.prim_index, valid) for f in front])
        valid &= dr.dot(normal, d) < 0
        colours = [dr.gather(mi.Float, l, hit.prim_index, valid) for l in light]
        for i, y_i in enumerate(basis(d)):
            for k in range(3):
                sums = dr.block_sum(y_i * colours[k], rays)
                made[first:first + n, i, k] = np.array(sums) * (4 * PI / rays)
    return made


def error(made):
    off = (made - reference) * cosine
    return np.sqrt((off ** 2).sum() / ((reference * cosine) ** 2).sum())


began = time.perf_counter()
rays = 256
while rays <= 1 << 20:
    # Once for what is compiled, and then to be timed.
    volume(rays)
    started = time.perf_counter()
    made = volume(rays)
    seconds = time.perf_counter() - started
    print(rays, seconds, error(made), flush=True)
    if error(made) <= wanted or time.perf_counter() - began + 4 * seconds > limit:
        break
    rays *= 2
