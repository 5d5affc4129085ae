// Irradiance that the occluder blocks at each receiver pixel: Σ_j E_xj M_xj over a batch of shadow maps.
// The arithmetic is that of `ShadowMap::blocked` and `RadianceTransfer::add` in src/shadow.
#import insitu::shadow_map_types::{Frame, ShadowMap}

struct Receiver {
    position: vec3<f32>,
    vertex_a: u32,
    normal: vec3<f32>,
    vertex_b: u32,
    weights: vec3<f32>,
    vertex_c: u32,
    across: vec3<f32>,  // one pixel to the right on the surface, m
    padding_a: u32,
    down: vec3<f32>,
    padding_b: u32,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> maps: array<ShadowMap>;
@group(0) @binding(2) var<storage, read> receivers: array<Receiver>;
@group(0) @binding(3) var<storage, read> transfers: array<f32>;
@group(0) @binding(4) var<storage, read_write> blocked: array<vec4<f32>>;
@group(0) @binding(6) var depths: texture_depth_2d_array;

const DEPTH_BIAS: f32 = 5e-4;
const STEEPEST: f32 = 16.0;

// Whether the occluder lies before the receiver's plane in the texel onto which the receiver falls.
fn mask(receiver: Receiver, map: u32) -> bool {
    let offset = maps[map].offset;
    let position = receiver.position + receiver.across * offset.x + receiver.down * offset.y;
    let q = maps[map].map_from_world * vec4<f32>(position, 1.0);
    if q.w <= 1e-6 {
        return false;
    }
    let p = q.xyz / q.w;
    let size = f32(maps[map].size);
    if p.x < 0.0 || p.y < 0.0 || p.x >= size || p.y >= size || p.z <= 0.0 {
        return false;
    }
    let texel = floor(p.xy);
    let depth = textureLoad(depths, vec2<i32>(texel), map, 0);
    if depth >= 1.0 {
        return false;
    }
    let plane = maps[map].planes * vec4<f32>(receiver.normal, -dot(receiver.normal, position));
    let limit = STEEPEST / size;
    var slope = vec2<f32>(0.0);
    if plane.z != 0.0 {
        slope = clamp(-plane.xy / plane.z, vec2<f32>(-limit), vec2<f32>(limit));
    }
    return depth < p.z + dot(slope, texel + 0.5 - p.xy) - DEPTH_BIAS;
}

// Whether a map can shadow anything in a sphere (centre, radius): `MapPlan::may_shadow`.
fn may_shadow(sphere: vec4<f32>, map: u32) -> bool {
    let reach = -sphere.w * 1.001 - 1e-4;
    for (var i = 0u; i < 5u; i++) {
        if dot(maps[map].sides[i], vec4<f32>(sphere.xyz, 1.0)) < reach {
            return false;
        }
    }
    return true;
}

// Irradiance that a map's cluster sends to a receiver vertex.
fn sent(vertex: u32, map: u32) -> vec3<f32> {
    let at = 3u * (vertex * frame.clusters + maps[map].cluster);
    return vec3<f32>(transfers[at], transfers[at + 1u], transfers[at + 2u]);
}

// Neighbouring pixels share a workgroup, whose maps are chosen first.
const GROUP: u32 = 64u;
const MOST_MAPS: u32 = 1024u;
@group(0) @binding(5) var<storage, read> spheres: array<vec4<f32>>;
var<workgroup> needed: array<u32, MOST_MAPS>;

@compute @workgroup_size(GROUP)
fn subtract(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    for (var map = lane; map < frame.maps; map += GROUP) {
        needed[map] = select(0u, 1u, may_shadow(spheres[group.x], map));
    }
    workgroupBarrier();
    if id.x >= frame.pixels {
        return;
    }
    let receiver = receivers[id.x];
    var sum = blocked[id.x].xyz;
    for (var map = 0u; map < frame.maps; map++) {
        if needed[map] == 0u {
            continue;
        }
        if mask(receiver, map) {
            let irradiance = receiver.weights.x * sent(receiver.vertex_a, map)
                + receiver.weights.y * sent(receiver.vertex_b, map)
                + receiver.weights.z * sent(receiver.vertex_c, map);
            sum += maps[map].weight * irradiance;
        }
    }
    blocked[id.x] = vec4<f32>(sum, 0.0);
}
