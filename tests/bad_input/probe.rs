//! Stage `probe`.

use super::cases::{case, check};
use super::spoil::Spoil::*;

#[test]
fn the_ball_must_be_whole_and_where_it_is_said_to_be() {
    check(&[
        case(
            "radius too large",
            &[Set("[probe]\nradius_m = 0.3\n")],
            "probe",
            1,
            "looking for the mirror ball in the photographs of role `probe`: the mirror ball was not found: at the best place its mirror image agrees with the surface by a correlation of #, 0.80 is needed",
            "check probe.radius_m and probe.support_m, and that grid and ball stand on the same surface",
        ),
        case(
            "ball half outside",
            &[Turn("probe", 18.0)],
            "probe",
            1,
            "looking for the mirror ball in the photographs of role `probe`: the mirror ball is cut off by the border of the picture: # % of its outline lie outside",
            "use a picture that shows the whole ball",
        ),
        case(
            "ball outside",
            &[Turn("probe", 26.0)],
            "probe",
            1,
            "looking for the mirror ball in the photographs of role `probe`: the mirror ball was not found: at the best place its mirror image agrees with the surface by a correlation of #, 0.80 is needed",
            "check probe.radius_m and probe.support_m, and that grid and ball stand on the same surface",
        ),
        case(
            "support elsewhere",
            &[Set("[probe]\nsupport_m = 5.0\n")],
            "probe",
            1,
            "looking for the mirror ball in the photographs of role `probe`: the camera is # m above the plane through the ball's centre: it must look from above",
            "check probe.support_m and the pose of the grid",
        ),
        case(
            "probe black",
            &[Flat("probe", 0)],
            "probe",
            1,
            "looking for the grid in the photographs of role `probe`: no grid of 7×5 inner corners is seen whole",
            "show the whole grid, sharp and larger, and check `calibrate.inner_corners`",
        ),
        case(
            "no photograph of the ball",
            &[Set(r#"[ingest]
photos = "photos"
[ingest.roles]
probe = []
"#)],
            "insitu run case.toml --to probe",
            1,
            "looking for the mirror ball in the photographs of role `probe`: there is no photograph of the mirror ball",
            "name its photographs in pipeline.toml under [ingest.roles] as `probe`",
        ),
    ]);
}
