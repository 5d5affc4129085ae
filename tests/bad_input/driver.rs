//! The command line of `insitu`.

use super::cases::{case, check};
use super::spoil::Spoil::*;

#[test]
fn the_driver_says_what_cannot_be() {
    check(&[
        case(
            "unknown stage",
            &[],
            "insitu run case.toml --to trasfer",
            2,
            "no stage `trasfer`; the stages are ingest, response, merge, calibrate, probe, model, illuminate, irradiance, transfer, render, composite, evaluate",
            "did you mean `transfer`?",
        ),
        case(
            "from after to",
            &[],
            "insitu run case.toml --from render --to merge",
            2,
            "stage `render` comes after `merge`",
            "exchange --from and --to",
        ),
        case(
            "new on no folder",
            &[],
            "insitu new nowhere",
            1,
            "looking for photographs: nowhere: no such folder",
            "check the name",
        ),
        case(
            "new on an empty folder",
            &[Write("empty/readme.txt", "none\n")],
            "insitu new empty",
            1,
            "listing the photographs: empty: holds no JPEG, PNG, TIFF, HDR or EXR file",
            "put the photographs there, or name their folder with `photos` in [ingest]",
        ),
        case(
            "new over settings",
            &[],
            "insitu new .",
            1,
            "writing new settings: ./pipeline.toml: exists already",
            "edit it, or move it away first: nothing is written over",
        ),
        case(
            "validate without captures",
            &[Write("empty/readme.txt", "none\n")],
            "insitu validate empty",
            2,
            "no pipeline.toml under empty",
            "write one with `insitu new FOLDER`",
        ),
        case(
            "validate no folder",
            &[],
            "insitu validate nowhere",
            1,
            "looking for captures: nowhere: no such folder",
            "check the name",
        ),
        case(
            "earlier stage missing",
            &[Remove("work/response")],
            "insitu run case.toml --from merge --to merge",
            1,
            "merge needs response.json: ./work/response: stage `response` has not finished",
            "run `insitu run --to merge`",
        ),
    ]);
}
