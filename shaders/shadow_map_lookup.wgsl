// Whether a surface lies in the occluder's shadow, by one map of the atlas: `ShadowMap::blocked` in src/shadow.
#define_import_path insitu::shadow_map_lookup
#import insitu::shadow_map_types::ShadowMap

@group(0) @binding(0) var<storage, read> maps: array<ShadowMap>;
@group(0) @binding(1) var atlas: texture_depth_2d_array;

const DEPTH_BIAS: f32 = 5e-4;
const STEEPEST: f32 = 16.0;
const EMPTY: f32 = 1.0;

// Whether the occluder lies before the receiver's plane in the texel onto which the receiver falls.
fn in_shadow(position: vec3<f32>, normal: vec3<f32>, map: u32) -> bool {
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
    let plane = maps[map].planes * vec4<f32>(normal, -dot(normal, position));
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
