//! References and truth: stage `evaluate`.

use super::cases::{case, check};
use super::spoil::Spoil::*;

#[test]
fn references_are_checked() {
    check(&[
        case(
            "reference missing",
            &[Set(r#"[evaluate]
reference = "truth/none.exr"
"#)],
            "evaluate",
            1,
            "opening an input of stage `evaluate`: ./truth/none.exr: No such file or directory (os error 2)",
            "check the name and the folder in pipeline.toml",
        ),
        case(
            "reference of another size",
            &[
                Exr("small.exr", 320, 240, false),
                Set(r#"[evaluate]
reference = "small.exr"
"#),
            ],
            "evaluate",
            1,
            "comparing with small.exr: the reference is 320×240 px, the plate 640×480 px",
            "give references of the plate's view and size, or none",
        ),
        case(
            "reference holds NaN",
            &[
                Exr("nan.exr", 640, 480, true),
                Set(r#"[evaluate]
reference = "nan.exr"
"#),
            ],
            "evaluate",
            1,
            "reading an EXR: ./nan.exr: channel G is NaN at pixel (1, 0)",
            "repair or leave out the file: every sample must be a finite number",
        ),
        case(
            "mask missing",
            &[Set(r#"[evaluate]
reference_mask = "photos/none.png"
"#)],
            "evaluate",
            1,
            "opening an input of stage `evaluate`: ./photos/none.png: No such file or directory (os error 2)",
            "check the name and the folder in pipeline.toml",
        ),
        case(
            "unknown bound",
            &[Set("[evaluate.bounds]\nrelative_shadw_error = 0.3\n")],
            "evaluate",
            2,
            "`evaluate.bounds` names a figure `relative_shadw_error`, which there is not",
            "did you mean `relative_shadow_error`?",
        ),
        case(
            "negative bound",
            &[Set("[evaluate.bounds]\nrelative_shadow_error = -0.3\n")],
            "evaluate",
            2,
            "`evaluate.bounds.relative_shadow_error` is -0.3, expected a finite number of at least 0",
            "bounds are largest allowed magnitudes",
        ),
        case(
            "truth is not JSON",
            &[Set(r#"[evaluate]
truth = "object.obj"
"#)],
            "evaluate",
            1,
            "reading the truth: ./object.obj: not JSON (expected value at line 1 column 1)",
            "check the file, or leave out the setting",
        ),
        case(
            "truth of something else",
            &[Set(r#"[evaluate]
truth = "work/model/scene.json"
"#)],
            "evaluate",
            1,
            "judging stages against work/model/scene.json: `intrinsics.fx` is missing or not of the expected shape",
            "`evaluate.truth` takes the truth.json of a rendered capture",
        ),
    ]);
}
