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

const TYPES: Shader = shader!("shadow_map_types.wgsl");
/// Draws shadow maps.
pub(crate) const SHADOW_MAP: Shader = shader!("shadow_map.wgsl");
/// Looks them up and sums what is blocked.
pub(crate) const SUBTRACT_TRANSFERS: Shader = shader!("subtract_transfers.wgsl");
/// Loads texels and does nothing else.
pub(crate) const LOOKUP_CEILING: Shader = shader!("lookup_ceiling.wgsl");

/// Resolves the imports and validates.
pub(crate) fn compose(shader: Shader) -> Result<(naga::Module, naga::valid::ModuleInfo), Problem> {
    let refuse = |problem: String| Problem::Shader { name: shader.name, problem };
    let mut composer = Composer::default();
    composer
        .add_composable_module(ComposableModuleDescriptor {
            source: TYPES.source,
            file_path: TYPES.name,
            ..Default::default()
        })
        .map_err(|e| refuse(e.emit_to_string(&Composer::default())))?;
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
        for shader in [SHADOW_MAP, SUBTRACT_TRANSFERS, LOOKUP_CEILING] {
            let text = wgsl(shader).unwrap();
            assert!(naga::front::wgsl::parse_str(&text).is_ok(), "{}", shader.name);
        }
    }

    #[test]
    fn constants_are_those_of_the_plain_reference() {
        let (module, _) = compose(SUBTRACT_TRANSFERS).unwrap();
        use crate::shadow::{DEPTH_BIAS, EMPTY, STEEPEST};
        for (name, value) in [("DEPTH_BIAS", DEPTH_BIAS), ("STEEPEST", STEEPEST), ("EMPTY", EMPTY)] {
            let (_, constant) =
                module.constants.iter().find(|(_, c)| c.name.as_deref() == Some(name)).unwrap();
            let literal = &module.global_expressions[constant.init];
            assert!(
                matches!(literal, naga::Expression::Literal(naga::Literal::F32(v)) if *v == value),
                "{name} is {literal:?}, not {value}"
            );
        }
    }
}
