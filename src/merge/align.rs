//! Motion between exposures of one view: a tripod that was touched, a camera in the hand. Compared is the logarithm of the
//! exposure at edges that both frames hold, so that the exposure time makes no difference.

mod homography;
mod motion;
mod moved;

pub use motion::{Motion, motions};
pub use moved::Moved;

/// Codes that a frame holds.
const HELD: std::ops::Range<f32> = 0.1..0.92;
/// Fewer edges tell nothing.
const NEEDED: usize = 200;
/// A motion must make the frames agree better by this factor, so that noise moves nothing.
const GAIN: f64 = 0.85;
