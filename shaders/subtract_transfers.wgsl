// Irradiance that the occluder blocks at each receiver pixel: Σ_j L_j G_xj M_xj over a batch of shadow maps.
// The arithmetic is that of `ShadowMap::blocked` and `RadianceTransfer::add` in src/shadow.
#import insitu::shadow_map_types::{Frame, ShadowMap}

struct Receiver {
    position: vec3<f32>,
    column_a: u32,
    normal: vec3<f32>,
    column_b: u32,
    barycentric: vec3<f32>,
    column_c: u32,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> maps: array<ShadowMap>;
@group(0) @binding(2) var<storage, read> receivers: array<Receiver>;
@group(0) @binding(3) var<storage, read> transfers: array<f32>;
@group(0) @binding(4) var<storage, read_write> blocked: array<vec4<f32>>;
@group(0) @binding(5) var depths: texture_depth_2d_array;

const DEPTH_BIAS: f32 = 5e-4;
const STEEPEST: f32 = 16.0;

fn hit(texel: vec2<i32>, map: u32, depth: f32) -> f32 {
    return select(0.0, 1.0, textureLoad(depths, texel, map, 0) < min(depth, 1.0));
}

// 2×2 percentage-closer filtering with the receiver plane's depth in each texel.
fn mask(receiver: Receiver, map: u32) -> f32 {
    let q = maps[map].map_from_world * vec4<f32>(receiver.position, 1.0);
    if q.w <= 1e-6 {
        return 0.0;
    }
    let p = q.xyz / q.w - vec3<f32>(0.5, 0.5, 0.0);
    let first = floor(p.xy);
    let last = f32(frame.map_px - 1u);
    if first.x < 0.0 || first.y < 0.0 || first.x >= last || first.y >= last || p.z <= 0.0 {
        return 0.0;
    }
    let plane = maps[map].planes * vec4<f32>(receiver.normal, -dot(receiver.normal, receiver.position));
    let limit = STEEPEST / f32(frame.map_px);
    var slope = vec2<f32>(0.0);
    if plane.z != 0.0 {
        slope = clamp(-plane.xy / plane.z, vec2<f32>(-limit), vec2<f32>(limit));
    }
    let f = p.xy - first;
    let texel = vec2<i32>(first);
    let corner = p.z - DEPTH_BIAS - slope.x * f.x - slope.y * f.y;
    let top = hit(texel, map, corner) * (1.0 - f.x)
        + hit(texel + vec2<i32>(1, 0), map, corner + slope.x) * f.x;
    let bottom = hit(texel + vec2<i32>(0, 1), map, corner + slope.y) * (1.0 - f.x)
        + hit(texel + vec2<i32>(1, 1), map, corner + slope.x + slope.y) * f.x;
    return top * (1.0 - f.y) + bottom * f.y;
}

@compute @workgroup_size(64)
fn subtract(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= frame.pixels {
        return;
    }
    let receiver = receivers[id.x];
    var sum = blocked[id.x].xyz;
    for (var map = 0u; map < frame.maps; map++) {
        let share = mask(receiver, map);
        if share > 0.0 {
            let row = maps[map].row * frame.columns;
            let transfer = vec3<f32>(
                transfers[row + receiver.column_a],
                transfers[row + receiver.column_b],
                transfers[row + receiver.column_c],
            );
            sum += maps[map].radiance * (share * dot(transfer, receiver.barycentric));
        }
    }
    blocked[id.x] = vec4<f32>(sum, 0.0);
}
