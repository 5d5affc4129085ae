//! A pose filter of constant velocity (the α–β filter, Benedict and Bordner 1962) whose gain follows the innovation: where a measured pose
//! differs from the predicted one by noise alone, it is mostly noise, and where by more, the camera has moved.
//!
//! All six parameters have one gain. The errors of a camera's place and turn cancel in the picture, and would not if one were
//! filtered more than the other.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Gain where innovation is noise.
const LEAST_GAIN: f64 = 0.12;
/// Innovation, in standard deviations of the noise, at which the gain is half-way to 1.
const HALF_WAY: f64 = 2.4;

/// What is known of a moving camera.
#[derive(Debug, Clone, Default)]
pub struct Filter {
    state: Option<State>,
}

#[derive(Debug, Clone)]
struct State {
    pose: Isometry3<f64>,
    /// Per frame: shift (m) and turn (rad), in the world.
    velocity: [Vector3<f64>; 2],
}

impl Filter {
    /// The pose that the next frame is expected to show.
    pub fn predict(&self) -> Option<Isometry3<f64>> {
        self.state.as_ref().map(|s| moved(&s.pose, &s.velocity, 1.0))
    }

    /// The pose of a frame from a measured one. `apart` gives the difference of two poses as seen in the picture in standard
    /// deviations of its noise.
    pub fn update(
        &mut self,
        measured: Isometry3<f64>,
        apart: impl Fn(&Isometry3<f64>, &Isometry3<f64>) -> f64,
    ) -> Isometry3<f64> {
        let predicted = self.predict();
        let (Some(state), Some(predicted)) = (&mut self.state, predicted) else {
            self.state = Some(State { pose: measured, velocity: [Vector3::zeros(); 2] });
            return measured;
        };
        let innovation = apart(&predicted, &measured);
        let motion = (innovation / HALF_WAY).powi(4);
        let gain = LEAST_GAIN.max(motion / (1.0 + motion));
        // Benedict and Bordner's relation of both gains: no overshoot after a jump.
        let velocity_gain = gain * gain / (2.0 - gain);
        let step = [
            measured.translation.vector - predicted.translation.vector,
            (measured.rotation * predicted.rotation.inverse()).scaled_axis(),
        ];
        state.pose = moved(&predicted, &step, gain);
        for (velocity, step) in state.velocity.iter_mut().zip(step) {
            *velocity += step * velocity_gain;
        }
        state.pose
    }

    /// Forgets: what is measured next is taken as it is.
    pub fn reset(&mut self) {
        self.state = None;
    }
}

fn moved(pose: &Isometry3<f64>, [shift, turn]: &[Vector3<f64>; 2], share: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::from(pose.translation.vector + shift * share),
        UnitQuaternion::from_scaled_axis(turn * share) * pose.rotation,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng, rngs::SmallRng};

    type Path<'a> = &'a dyn Fn(f64) -> Isometry3<f64>;

    /// Noise of each parameter.
    const SIGMA: f64 = 1e-3;

    fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        let shift = (a.translation.vector - b.translation.vector).norm_squared();
        ((shift + a.rotation.angle_to(&b.rotation).powi(2)) / 6.0).sqrt() / SIGMA
    }

    /// Root mean square error (standard deviations) of the frames from the twentieth on: measured, filtered.
    fn errors(path: impl Fn(f64) -> Isometry3<f64>) -> [f64; 2] {
        let mut rng = SmallRng::seed_from_u64(5);
        let mut noise =
            || Vector3::from_fn(|_, _| (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0) * SIGMA;
        let (mut filter, mut sums) = (Filter::default(), [0.0; 2]);
        for frame in 0..220 {
            let truth = path(frame as f64);
            let measured = moved(&truth, &[noise(), noise()], 1.0);
            let found = filter.update(measured, apart);
            if frame >= 20 {
                sums[0] += apart(&measured, &truth).powi(2) / 200.0;
                sums[1] += apart(&found, &truth).powi(2) / 200.0;
            }
        }
        sums.map(f64::sqrt)
    }

    fn pose(x: f64, turn: f64) -> Isometry3<f64> {
        Isometry3::new(Vector3::new(x, 0.3, 1.0), Vector3::new(0.0, turn, 0.1))
    }

    #[test]
    fn a_still_camera_trembles_much_less_than_its_measurements() {
        let [measured, filtered] = errors(|_| pose(0.0, 0.2));
        assert!(filtered < 0.4 * measured, "{filtered} of {measured}");
    }

    #[test]
    fn a_moving_camera_does_not_lag() {
        let paths: [(&str, Path); 3] = [
            ("steady", &|t| pose(0.01 * t, 0.02 * t)),
            ("to and fro", &|t| pose(0.1 * (0.1 * t).sin(), 0.2 * (0.08 * t).cos())),
            ("jerks", &|t| if (t as usize / 40).is_multiple_of(2) { pose(0.0, 0.0) } else { pose(0.2, 0.1) }),
        ];
        for (name, path) in paths {
            let [measured, filtered] = errors(path);
            assert!(filtered < 1.3 * measured, "{name}: {filtered} after {measured}");
        }
    }
}
