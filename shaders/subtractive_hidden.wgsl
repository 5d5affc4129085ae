// Irradiance that the object hides from a surface, light by light: `hidden` and `Casters::hide` in src/subtractive.
#define_import_path insitu::subtractive_hidden
#import insitu::shadow_map_lookup::in_shadow
#import insitu::rays::any_hit

struct Light {
    origin: vec3<f32>,    // a position (m), or a unit direction towards distant light
    kind: u32,            // DISTANT, POINT or PATCH
    power: vec3<f32>,     // irradiance at the environment's place
    map: u32,             // NONE: too near for one
    normal: vec3<f32>,    // of the surface that a PATCH lies on
    padding_a: u32,
    reference: f32,       // see `Near` in src/subtractive/lights.rs
    spread: f32,
    half: f32,            // 1 or -1: to which half of all lights it belongs
    padding_b: u32,
}

struct Sample {
    position: vec3<f32>,
    present: u32,         // 0: its pixels see no surface
    normal: vec3<f32>,
    padding: u32,
    value: vec4<f32>,     // what is hidden, and the difference of the halves
}

struct Detail {
    lights: u32,          // in this batch
    scene: u32,           // roots of the hierarchies
    object: u32,
    add: u32,             // 1: to what is found already; 0: this is the first batch
    side: u32,            // of the square of pixels that share a sample, px
    columns: u32,         // of samples
    rows: u32,
    width: u32,           // of the plate, px
    last: u32,            // 1: no batch follows
    padding_a: u32,
    padding_b: vec2<u32>,
}

@group(0) @binding(4) var<storage, read> lights: array<Light>;
@group(0) @binding(5) var<uniform> detail: Detail;

const DISTANT: u32 = 0u;
const POINT: u32 = 1u;
const NONE: u32 = 0xffffffffu;
const OFFSET: f32 = 1e-4; // rays start so far off the model's surfaces, m

// Whether something below a root hides a light from a position: `ShadowOrigin::hidden_by`.
fn hidden_by(root: u32, light: u32, position: vec3<f32>) -> bool {
    if lights[light].kind == DISTANT {
        return any_hit(root, position, lights[light].origin, vec2<f32>(0.0, 3.0e38));
    }
    return any_hit(root, position, lights[light].origin - position, vec2<f32>(1e-4, 1.0 - 1e-4));
}

// Unit direction towards a light, and its irradiance over its power: `Light::seen_from`.
fn seen_from(light: u32, position: vec3<f32>) -> vec4<f32> {
    if lights[light].kind == DISTANT {
        return vec4<f32>(lights[light].origin, 1.0);
    }
    let to = lights[light].origin - position;
    let squared = dot(to, to);
    let direction = select(vec3<f32>(0.0), to * inverseSqrt(squared), squared > 0.0);
    if lights[light].kind == POINT {
        return vec4<f32>(direction, 1.0);
    }
    let cosine = -dot(lights[light].normal, direction);
    let gain = cosine / (squared + lights[light].spread) / lights[light].reference;
    return vec4<f32>(direction, max(gain, 0.0));
}

// Of all lights of the batch; then the difference of their two halves, as luminance.
fn hidden(position: vec3<f32>, normal: vec3<f32>) -> vec4<f32> {
    var sum = vec4<f32>(0.0);
    for (var light = 0u; light < detail.lights; light++) {
        let seen = seen_from(light, position);
        let weight = max(dot(normal, seen.xyz), 0.0) * seen.w;
        if weight <= 0.0 {
            continue;
        }
        if lights[light].map == NONE {
            if !hidden_by(detail.object, light, position) {
                continue;
            }
        } else if !in_shadow(position, normal, lights[light].map) {
            continue;
        }
        if hidden_by(detail.scene, light, position + normal * OFFSET) {
            continue;
        }
        let gone = weight * lights[light].power;
        let luminance = dot(gone, vec3<f32>(0.2126, 0.7152, 0.0722));
        sum += vec4<f32>(gone, lights[light].half * luminance);
    }
    return sum;
}
