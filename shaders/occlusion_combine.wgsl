// What the object takes of a rectangular light at each pixel, and ε: `OcclusionTextures::visibility` and `PlateShadow` in
// src/occlusion.
#import insitu::occlusion_types::{PRODUCT, SUM}
#import insitu::occlusion_lookup::{textures, average}
#import insitu::receiver::{Receiver, removed}

@group(1) @binding(0) var<storage, read> receivers: array<Receiver>;
@group(1) @binding(1) var<storage, read_write> blocked: array<vec4<f32>>;  // irradiance, summed over lights
@group(1) @binding(2) var<storage, read_write> epsilon: array<vec4<f32>>;
@group(1) @binding(3) var<storage, read> reached: array<u32>;              // pixels that the object may shadow
@group(1) @binding(4) var<storage, read> factors: array<f32>;              // form factor of the light, by pixel
@group(1) @binding(5) var<storage, read_write> found: array<vec2<f32>>;    // so far, by batches: without and with the object

const PI: f32 = 3.14159265;
const NONE: u32 = 0xffffffffu;

fn combined(before: f32, shadow: f32) -> f32 {
    if textures.combination == PRODUCT {
        return before * (1.0 - shadow);
    }
    if textures.combination == SUM {
        return before + shadow;
    }
    return max(before, shadow);
}

fn visible(shadows: f32) -> f32 {
    if textures.combination == PRODUCT {
        return shadows;
    }
    return max(1.0 - shadows, 0.0);
}

@compute @workgroup_size(256)
fn combine(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = reached[id.x];
    if pixel == NONE {
        return;
    }
    let q = (textures.light_from_world * vec4<f32>(receivers[pixel].position, 1.0)).xyz;
    var shadows = vec2<f32>(select(0.0, 1.0, textures.combination == PRODUCT));
    if textures.first > 0u {
        shadows = found[pixel];
    }
    for (var i = 0u; i < textures.layers; i++) {
        let layer = textures.first + i;
        let plane = textures.planes[layer >> 1u];
        // Nothing in the slice or before it, linearly more behind it.
        let weight = clamp((q.z - plane.y) / plane.z, 0.0, 1.0);
        if weight > 0.0 {
            // Where the pyramid to the light cuts the slice (eq. 4), texels.
            let share = plane.y / q.z;
            let scale = textures.behind / (plane.y + textures.behind);
            let half = 0.5 * f32(textures.size);
            let centre = (q.xy * (share * scale) + 1.0) * half;
            let side = max(2.0 * (1.0 - share) * scale * half, 1.0);
            let shadow = weight * average(i * textures.stride, centre, side);
            shadows[layer & 1u] = combined(shadows[layer & 1u], shadow);
        }
    }
    if textures.last == 0u {
        found[pixel] = shadows;
        return;
    }
    let taken = max(visible(shadows.x) - visible(shadows.y), 0.0);
    let sum = blocked[pixel].xyz + PI * factors[pixel] * taken * textures.radiance;
    blocked[pixel] = vec4<f32>(sum, 0.0);
    epsilon[pixel] = vec4<f32>(removed(receivers[pixel], sum), 0.0);
}
