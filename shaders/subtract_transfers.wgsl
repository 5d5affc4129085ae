// ε at each receiver pixel: Σ_j E_xj M_xj over a batch of shadow maps, as a share of all irradiance, times the plate.
// The arithmetic is that of `ShadowMap::blocked`, `RadianceTransfer::add` and `Pixel::removed` in src/shadow.
#import insitu::shadow_map_types::{Frame, ShadowMap}

struct Receiver {
    position: vec3<f32>,
    vertex_a: u32,
    normal: vec3<f32>,
    vertex_b: u32,
    weights: vec3<f32>,
    vertex_c: u32,
    across: vec3<f32>,     // one pixel to the right on the surface, m
    padding_a: u32,
    down: vec3<f32>,
    padding_b: u32,
    plate: vec3<f32>,      // radiance
    padding_c: u32,
    irradiance: vec3<f32>, // from all light
    padding_d: u32,
}

// Neighbouring pixels, at most as many as a workgroup has invocations.
struct Tile {
    centre: vec3<f32>,
    radius: f32,
    first: u32,
    count: u32,
    padding: vec2<u32>,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> maps: array<ShadowMap>;
@group(0) @binding(2) var<storage, read> rows: array<u32>;      // of transfers, by receiver vertex
@group(0) @binding(3) var<storage, read> transfers: array<f32>; // [rows × clusters × 3], irradiance
@group(0) @binding(4) var atlas: texture_depth_2d_array;

@group(1) @binding(0) var<storage, read> tiles: array<Tile>;
@group(1) @binding(1) var<storage, read> affected: array<u32>;  // tile of each workgroup
@group(1) @binding(2) var<storage, read> receivers: array<Receiver>;
@group(1) @binding(3) var<storage, read_write> blocked: array<vec4<f32>>;
@group(1) @binding(4) var<storage, read_write> epsilon: array<vec4<f32>>;

const DEPTH_BIAS: f32 = 5e-4;
const STEEPEST: f32 = 16.0;
const EMPTY: f32 = 1.0;

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
    let depth = textureLoad(atlas, vec2<i32>(texel) + vec2<i32>(maps[map].corner), maps[map].layer, 0);
    if depth >= EMPTY {
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

// Whether a map can shadow anything in a sphere: `MapPlan::may_shadow`.
fn may_shadow(centre: vec3<f32>, radius: f32, map: u32) -> bool {
    let reach = -radius * 1.001 - 1e-4;
    for (var i = 0u; i < 5u; i++) {
        if dot(maps[map].sides[i], vec4<f32>(centre, 1.0)) < reach {
            return false;
        }
    }
    return true;
}

// Irradiance that a cluster sends to a receiver vertex.
fn sent(vertex: u32, cluster: u32) -> vec3<f32> {
    let at = 3u * (rows[vertex] * frame.clusters + cluster);
    return vec3<f32>(transfers[at], transfers[at + 1u], transfers[at + 2u]);
}

// Irradiance that a cluster sends to a receiver.
fn received(receiver: Receiver, cluster: u32) -> vec3<f32> {
    return receiver.weights.x * sent(receiver.vertex_a, cluster)
        + receiver.weights.y * sent(receiver.vertex_b, cluster)
        + receiver.weights.z * sent(receiver.vertex_c, cluster);
}

const GROUP: u32 = 256u;
// Maps of which a workgroup chooses at a time those that can shadow its tile: one bit each.
const CHUNK: u32 = 1024u;
const NONE: u32 = 0xffffffffu;
var<workgroup> needed: array<atomic<u32>, CHUNK / 32u>;

@compute @workgroup_size(GROUP)
fn subtract(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let tile = tiles[affected[group.x]];
    let pixel = tile.first + min(lane, tile.count - 1u);
    let receiver = receivers[pixel];
    var sum = vec3<f32>(0.0);
    if frame.add != 0u {
        sum = blocked[pixel].xyz;
    }
    var cluster = NONE;
    var share = 0.0;
    for (var start = 0u; start < frame.maps; start += CHUNK) {
        let count = min(CHUNK, frame.maps - start);
        if lane < CHUNK / 32u {
            atomicStore(&needed[lane], 0u);
        }
        workgroupBarrier();
        for (var i = lane; i < count; i += GROUP) {
            if may_shadow(tile.centre, tile.radius, start + i) {
                atomicOr(&needed[i / 32u], 1u << (i % 32u));
            }
        }
        workgroupBarrier();
        // In order, so that the sum is the same in every run.
        for (var word = 0u; word * 32u < count; word++) {
            var bits = atomicLoad(&needed[word]);
            while bits != 0u {
                let map = start + word * 32u + firstTrailingBit(bits);
                bits &= bits - 1u;
                if maps[map].cluster != cluster {
                    if share > 0.0 {
                        sum += share * received(receiver, cluster);
                    }
                    cluster = maps[map].cluster;
                    share = 0.0;
                }
                if mask(receiver, map) {
                    share += maps[map].weight;
                }
            }
        }
        workgroupBarrier();
    }
    if share > 0.0 {
        sum += share * received(receiver, cluster);
    }
    if lane >= tile.count {
        return;
    }
    blocked[pixel] = vec4<f32>(sum, 0.0);
    let lit = receiver.irradiance > vec3<f32>(0.0);
    let part = select(vec3<f32>(0.0), clamp(sum / receiver.irradiance, vec3<f32>(0.0), vec3<f32>(1.0)), lit);
    epsilon[pixel] = vec4<f32>(max(receiver.plate, vec3<f32>(0.0)) * part, 0.0);
}
