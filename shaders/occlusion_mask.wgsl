// All slices in one pass: each fragment sets the bit of the slice that it lies in. The arithmetic is that of `Mask::draw` in
// src/occlusion/slices.rs.
#import insitu::occlusion_types::{Textures, OBJECT}

@group(0) @binding(0) var<uniform> textures: Textures;
@group(0) @binding(1) var<storage, read> vertices: array<f32>;   // x, y, z
@group(0) @binding(2) var<storage, read> triangles: array<u32>;
@group(0) @binding(3) var<storage, read_write> mask: array<atomic<u32>>;

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) depth: f32,
    @location(1) @interpolate(flat) range: vec2<f32>, // depths of the triangle
    @location(2) @interpolate(flat) object: u32,
}

fn corner(index: u32) -> vec3<f32> {
    let at = 3u * triangles[index];
    let p = vec4<f32>(vertices[at], vertices[at + 1u], vertices[at + 2u], 1.0);
    return (textures.light_from_world * p).xyz;
}

// Instance 0 is the scene, 1 the object. What lies nearer to the light than the first slice is clipped.
@vertex
fn draw(@builtin(vertex_index) index: u32, @builtin(instance_index) instance: u32) -> Corner {
    let first = index - index % 3u;
    let depths = vec3<f32>(corner(first).z, corner(first + 1u).z, corner(first + 2u).z);
    let q = corner(index);
    var out: Corner;
    out.position = vec4<f32>(
        q.x * textures.behind,
        -q.y * textures.behind,
        0.5 * (q.z - textures.near),
        q.z + textures.behind,
    );
    out.depth = q.z;
    out.range = vec2<f32>(min(depths.x, min(depths.y, depths.z)), max(depths.x, max(depths.y, depths.z)));
    out.object = instance;
    return out;
}

@fragment
fn mark(in: Corner) {
    let depth = clamp(in.depth, in.range.x, in.range.y);
    let texel = vec2<u32>(in.position.xy);
    for (var k = 0u; k < textures.slices; k++) {
        if depth >= textures.planes[k].x && depth < textures.planes[k].y {
            atomicOr(&mask[texel.y * textures.size + texel.x], 1u << (k + OBJECT * in.object));
        }
    }
}
