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
            "looking for the grid in the photographs of role `probe`: no grid of 7×5 inner corners is seen, whole or in part",
            "show more of the grid, sharp and larger, and check `calibrate.inner_corners`",
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

#[test]
fn views_lenses_and_maps_must_be_what_they_are_said_to_be() {
    check(&[
        case(
            "a view without photographs",
            &[Set("[probe]\nviews = [{ files = \"side_*.jpg\" }]\n")],
            "probe",
            1,
            "sorting the views of the ball: no photograph of role `probe` is called `side_*.jpg`",
            "check `files` under [[probe.views]]",
        ),
        case(
            "a view from beyond the zenith",
            &[Set("[probe]\nviews = [{ elevation_deg = 120.0 }]\n")],
            "probe",
            2,
            "case.toml:3:1: `elevation_deg` of a view is 120",
            "give a number from -90 to 90",
        ),
        case(
            "a crop from within the ball",
            &[Set("[probe]\ncamera = \"crop\"\ndistance_m = 0.05\n")],
            "probe",
            1,
            "placing the camera of the ball's crop: the camera is 0.05 m from the middle of a ball of 0.1 m radius",
            "give probe.distance_m, from the camera to the ball's middle",
        ),
        case(
            "a lens without a focal length",
            &[Set("[probe]\nsource = \"fisheye\"\n")],
            "probe",
            1,
            "taking the environment from the photographs of role `probe`: the fisheye lens has a focal length of 0 px",
            "give probe.focal_px, px per radian in the middle of the picture",
        ),
        case(
            "a photograph that is no map",
            &[Set("[probe]\nsource = \"map\"\n")],
            "probe",
            1,
            "taking the environment from the photographs of role `probe`: the map has 640×480 px: in its layout 2 px of width go to one of height",
            "check probe.layout",
        ),
    ]);
}
