// Resamples the shadow buffer by position and normal and subtracts it from the plate: `ShadowBuffer::at` in src/subtractive,
// `Pixel::removed` in src/shadow.
#import insitu::subtractive_hidden::{Sample, detail, hidden}
#import insitu::receiver::{Receiver, removed}

@group(1) @binding(0) var<storage, read> samples: array<Sample>;
@group(2) @binding(0) var<storage, read> receivers: array<Receiver>;
@group(2) @binding(1) var<storage, read_write> blocked: array<vec4<f32>>;
@group(2) @binding(2) var<storage, read_write> epsilon: array<vec4<f32>>;

// Pixels whose weights add up to less have no sample near and alike, and are found by themselves.
const LEAST_WEIGHT: f32 = 0.02;

// Weights of four neighbouring cells by the cubic B-spline, from their place between the middle two.
fn spline(t: f32) -> vec4<f32> {
    let s = 1.0 - t;
    let a = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0;
    let b = (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0;
    return vec4<f32>(s * s * s / 6.0, a, b, t * t * t / 6.0);
}

@compute @workgroup_size(256)
fn resample(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.x;
    if pixel >= arrayLength(&receivers) || receivers[pixel].place == 0u {
        return;
    }
    let receiver = receivers[pixel];
    let place = vec2<u32>((receiver.place - 1u) % detail.width, (receiver.place - 1u) / detail.width);
    var sum = vec4<f32>(0.0);
    var total = 0.0;
    if detail.side == 1u {
        let cell = place.y * detail.columns + place.x;
        sum = samples[cell].value;
        total = f32(samples[cell].present);
    } else {
        let side = f32(detail.side);
        let at = (vec2<f32>(place) + 0.5) / side - 0.5;
        let first = vec2<i32>(floor(at)) - 1;
        var across = spline(fract(at.x));
        var down = spline(fract(at.y));
        let metres = side * max(length(receiver.across), length(receiver.down));
        let inverse = 1.0 / max(metres * metres, 1.1754944e-38);
        for (var k = 0; k < 16; k++) {
            let cell = first + vec2<i32>(k & 3, k >> 2u);
            if cell.x < 0 || cell.y < 0 || cell.x >= i32(detail.columns) || cell.y >= i32(detail.rows) {
                continue;
            }
            let i = u32(cell.y) * detail.columns + u32(cell.x);
            if samples[i].present == 0u {
                continue;
            }
            let alike = max(dot(receiver.normal, samples[i].normal), 0.0);
            let apart = receiver.position - samples[i].position;
            let weight = across[k & 3] * down[k >> 2u] * alike * exp(-0.5 * dot(apart, apart) * inverse);
            total += weight;
            sum += weight * samples[i].value;
        }
    }
    if total < LEAST_WEIGHT {
        // By itself, batch by batch.
        sum = hidden(receiver.position, receiver.normal);
        if detail.add == 1u {
            sum += blocked[pixel];
        }
        blocked[pixel] = sum;
    } else {
        sum /= total;
    }
    if detail.last == 0u {
        return;
    }
    // The difference of the halves as the luminance that it is of the plate.
    let luminance = vec3<f32>(0.2126, 0.7152, 0.0722);
    let all = dot(receiver.irradiance, luminance);
    let difference = select(0.0, sum.w / all, all > 0.0) * dot(receiver.plate, luminance);
    epsilon[pixel] = vec4<f32>(removed(receiver, sum.xyz), difference);
}
