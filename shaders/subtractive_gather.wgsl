// Fills the shadow buffer of a plate: what is hidden at each sample. `ShadowBuffer::fill` in src/subtractive.
#import insitu::subtractive_hidden::{Sample, detail, hidden}

@group(1) @binding(0) var<storage, read_write> samples: array<Sample>;

@compute @workgroup_size(8, 8)
fn gather(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= detail.columns || id.y >= detail.rows {
        return;
    }
    let cell = id.y * detail.columns + id.x;
    var value = vec4<f32>(0.0);
    if detail.add == 1u {
        value = samples[cell].value;
    }
    if samples[cell].present == 1u {
        value += hidden(samples[cell].position, samples[cell].normal);
    }
    samples[cell].value = value;
}
