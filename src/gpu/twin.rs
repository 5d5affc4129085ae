//! What all shadow methods on the graphics processor have in common.

use super::Difference;
use crate::image::RadianceImage;
use crate::shadow::{Occluder, Problem, Removed};

/// A shadow method on the graphics processor, beside the same in plain Rust.
pub trait Twin {
    /// Name of the adapter, and what it is.
    fn adapter(&self) -> &str;

    /// ε of an object.
    fn removed_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem>;

    /// The same by plain Rust.
    fn plain_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem>;

    /// The plate.
    fn plate(&self) -> &RadianceImage;

    /// ε, and how far plain Rust lies from it.
    fn parity(&mut self, occluder: &Occluder) -> Result<(Removed, Difference), Problem> {
        let removed = self.removed_radiance(occluder)?;
        let plain = self.plain_radiance(occluder)?;
        let difference = Difference::between(self.plate(), &plain.epsilon, &removed.epsilon);
        Ok((removed, difference))
    }
}
