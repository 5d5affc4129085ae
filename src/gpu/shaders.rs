//! Shaders of `shaders/`, their imports resolved by naga_oil, validated without a device.

use super::Problem;
use naga_oil::compose::{ComposableModuleDescriptor, Composer, NagaModuleDescriptor};
use wgpu::naga;

/// A shader file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shader {
    name: &'static str,
    source: &'static str,
}

macro_rules! shader {
    ($file:literal) => {
        Shader { name: $file, source: include_str!(concat!("../../shaders/", $file)) }
    };
}

/// What others import, each after what it imports itself.
const MODULES: [Shader; 7] = [
    shader!("shadow_map_types.wgsl"),
    shader!("shadow_map_lookup.wgsl"),
    shader!("rays.wgsl"),
    shader!("subtractive_hidden.wgsl"),
    shader!("receiver.wgsl"),
    shader!("occlusion_types.wgsl"),
    shader!("occlusion_lookup.wgsl"),
];
/// Draws shadow maps.
pub(crate) const SHADOW_MAP: Shader = shader!("shadow_map.wgsl");
/// Looks them up and sums what is blocked.
pub(crate) const SUBTRACT_TRANSFERS: Shader = shader!("subtract_transfers.wgsl");
/// Draws all slices of occlusion textures.
pub(crate) const OCCLUSION_MASK: Shader = shader!("occlusion_mask.wgsl");
/// Begins mipmaps and N-buffers.
pub(crate) const OCCLUSION_TEXELS: Shader = shader!("occlusion_texels.wgsl");
/// Makes a level of mipmaps.
pub(crate) const OCCLUSION_MIPMAP: Shader = shader!("occlusion_mipmap.wgsl");
/// Makes a level of N-buffers.
pub(crate) const OCCLUSION_N_BUFFERS: Shader = shader!("occlusion_n_buffers.wgsl");
/// Makes summed-area tables.
pub(crate) const OCCLUSION_SUMMED_AREA: Shader = shader!("occlusion_summed_area.wgsl");
/// Combines slices and subtracts what the object takes.
pub(crate) const OCCLUSION_COMBINE: Shader = shader!("occlusion_combine.wgsl");
/// Fills the shadow buffer.
pub(crate) const SUBTRACTIVE_GATHER: Shader = shader!("subtractive_gather.wgsl");
/// Resamples it and subtracts.
pub(crate) const SUBTRACTIVE_RESAMPLE: Shader = shader!("subtractive_resample.wgsl");
/// Loads texels and does nothing else.
pub(crate) const LOOKUP_CEILING: Shader = shader!("lookup_ceiling.wgsl");

/// Resolves the imports and validates.
pub(crate) fn compose(shader: Shader) -> Result<(naga::Module, naga::valid::ModuleInfo), Problem> {
    let refuse = |problem: String| Problem::Shader { name: shader.name, problem };
    let mut composer = Composer::default();
    for module in MODULES {
        let descriptor = ComposableModuleDescriptor {
            source: module.source,
            file_path: module.name,
            ..Default::default()
        };
        composer.add_composable_module(descriptor).map_err(|e| refuse(e.to_string()))?;
    }
    let module = composer
        .make_naga_module(NagaModuleDescriptor {
            source: shader.source,
            file_path: shader.name,
            ..Default::default()
        })
        .map_err(|e| refuse(e.to_string()))?;
    let flags = naga::valid::ValidationFlags::all();
    let info = naga::valid::Validator::new(flags, naga::valid::Capabilities::default())
        .validate(&module)
        .map_err(|e| refuse(e.emit_to_string(shader.source)))?;
    Ok((module, info))
}

/// The shader with its imports as one WGSL text, as devices take it.
pub(crate) fn wgsl(shader: Shader) -> Result<String, Problem> {
    let (module, info) = compose(shader)?;
    naga::back::wgsl::write_string(&module, &info, naga::back::wgsl::WriterFlags::empty())
        .map_err(|e| Problem::Shader { name: shader.name, problem: e.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shader_is_valid() {
        for shader in [
            SHADOW_MAP,
            SUBTRACT_TRANSFERS,
            LOOKUP_CEILING,
            OCCLUSION_MASK,
            OCCLUSION_TEXELS,
            OCCLUSION_MIPMAP,
            OCCLUSION_N_BUFFERS,
            OCCLUSION_SUMMED_AREA,
            OCCLUSION_COMBINE,
            SUBTRACTIVE_GATHER,
            SUBTRACTIVE_RESAMPLE,
        ] {
            let text = wgsl(shader).unwrap();
            assert!(naga::front::wgsl::parse_str(&text).is_ok(), "{}", shader.name);
        }
    }

    /// Names of what was imported have a suffix.
    fn named(found: Option<&str>, name: &str) -> bool {
        found.is_some_and(|f| f == name || f.starts_with(&format!("{name}X_naga_oil")))
    }

    #[test]
    fn constants_are_those_of_the_plain_reference() {
        let (module, _) = compose(SUBTRACT_TRANSFERS).unwrap();
        use crate::shadow::{DEPTH_BIAS, EMPTY, STEEPEST};
        for (name, value) in [("DEPTH_BIAS", DEPTH_BIAS), ("STEEPEST", STEEPEST), ("EMPTY", EMPTY)] {
            let (_, constant) =
                module.constants.iter().find(|(_, c)| named(c.name.as_deref(), name)).unwrap();
            let literal = &module.global_expressions[constant.init];
            assert!(
                matches!(literal, naga::Expression::Literal(naga::Literal::F32(v)) if *v == value),
                "{name} is {literal:?}, not {value}"
            );
        }
    }
}
