// ε at each receiver pixel: Σ_j E_xj M_xj over a batch of shadow maps, as a share of all irradiance, times the plate.
// The arithmetic is that of `ShadowMap::blocked`, `RadianceTransfer::add` and `Pixel::removed` in src/shadow.
#import insitu::shadow_map_types::Frame
#import insitu::shadow_map_lookup::{maps, in_shadow, may_shadow}
#import insitu::receiver::{Receiver, removed}

// Neighbouring pixels, at most as many as a workgroup has invocations.
struct Tile {
    centre: vec3<f32>,
    radius: f32,
    first: u32,
    count: u32,
    padding: vec2<u32>,
}

@group(0) @binding(2) var<uniform> frame: Frame;
@group(0) @binding(3) var<storage, read> rows: array<u32>;      // of transfers, by receiver vertex
@group(0) @binding(4) var<storage, read> transfers: array<f32>; // [rows × clusters × 3], irradiance

@group(1) @binding(0) var<storage, read> tiles: array<Tile>;
@group(1) @binding(1) var<storage, read> affected: array<u32>;  // tile of each workgroup
@group(1) @binding(2) var<storage, read> receivers: array<Receiver>;
@group(1) @binding(3) var<storage, read_write> blocked: array<vec4<f32>>;
@group(1) @binding(4) var<storage, read_write> epsilon: array<vec4<f32>>;

// Whether the occluder hides a map's origin from the receiver, seen where in the pixel the map is looked up.
fn mask(receiver: Receiver, map: u32) -> bool {
    let offset = maps[map].offset;
    let position = receiver.position + receiver.across * offset.x + receiver.down * offset.y;
    return in_shadow(position, receiver.normal, map);
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
    epsilon[pixel] = vec4<f32>(removed(receiver, sum), 0.0);
}
