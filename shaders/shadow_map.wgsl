// Depth of the occluder from each source of a layer of the atlas, one instance a map.
#import insitu::shadow_map_types::{Frame, ShadowMap}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> maps: array<ShadowMap>;
@group(0) @binding(2) var<storage, read> order: array<u32>; // maps of the batch, layer by layer

// The occluder lies within its map (`Projection::fit`), so that none is drawn over its neighbour.
@vertex
fn draw(@location(0) position: vec3<f32>, @builtin(instance_index) instance: u32) -> @builtin(position) vec4<f32> {
    let map = order[instance];
    let q = maps[map].map_from_world * vec4<f32>(position, 1.0);
    let half = 0.5 * f32(frame.side);
    let texel = q.xy + vec2<f32>(maps[map].corner) * q.w;
    return vec4<f32>(texel.x / half - q.w, q.w - texel.y / half, q.z, q.w);
}
