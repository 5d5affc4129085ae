//! Stage `model`.

use super::cases::{case, check};
use super::spoil::Spoil::*;

#[test]
fn marks_must_make_sense() {
    check(&[
        case(
            "annotations missing",
            &[Remove("annotations.toml")],
            "model",
            1,
            "fitting the scene to annotations.toml: no primitive is given",
            "add at least one [[primitive]] to annotations.toml, e.g. a `ground`",
        ),
        case(
            "no primitive",
            &[Write("annotations.toml", "")],
            "model",
            1,
            "fitting the scene to annotations.toml: no primitive is given",
            "add at least one [[primitive]] to annotations.toml, e.g. a `ground`",
        ),
        case(
            "unknown kind",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "floor"
kind = "floor"
"#,
            )],
            "model",
            2,
            "./annotations.toml:3:8: unknown variant `floor`, expected one of `room`, `ground`, `box`, `wedge`, `cylinder`, `extrusion`, `quad`, `polygon`",
            "did you mean `room`?",
        ),
        case(
            "unknown key in marks",
            &[Swap("annotations.toml", "reflection = true", "reflected = true")],
            "model",
            2,
            "./annotations.toml:49:68: unknown field `reflected`, expected one of `corner`, `image`, `at`, `sigma_px`, `reflection`",
            "did you mean `reflection`?",
        ),
        case(
            "unknown parent",
            &[Swap("annotations.toml", "parent = \"desk_top\"", "parent = \"desktop\"")],
            "model",
            1,
            "fitting the scene to annotations.toml: `book` has the parent `desktop`, which is not in the file",
            "name what stands upright (room, ground, box, wedge, cylinder, extrusion) as the parent, or leave it out",
        ),
        case(
            "parents in a circle",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "a"
kind = "box"
parent = "b"
[[primitive]]
name = "b"
kind = "box"
parent = "a"
"#,
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: `a` refers, by way of others, to itself",
            "let one of them stand on the surface under the grid: leave out its `parent`",
        ),
        case(
            "a box that is to be searched",
            &[Swap("annotations.toml", "name = \"cabinet\"", "name = \"cabinet\"\nsearch = true")],
            "model",
            1,
            "fitting the scene to annotations.toml: `cabinet` is to be searched, which only a room without a parent can be",
            "leave out its `search`, and mark its corners",
        ),
        case(
            "two of one name",
            &[Swap("annotations.toml", "name = \"carton\"", "name = \"cabinet\"")],
            "model",
            1,
            "fitting the scene to annotations.toml: two primitives are called `cabinet`",
            "give each primitive a name of its own",
        ),
        case(
            "mark in an unknown picture",
            &[Swap(
                "annotations.toml",
                "image = \"plate_000.jpg\", at = [329.5, 172.5]",
                "image = \"plate_007.jpg\", at = [329.5, 172.5]",
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: corner `+--` of `room` is marked in plate_007.jpg, whose pose is not known",
            "mark photographs of the plate's place or of the probe, or in others four corners that are marked in the plate, too",
        ),
        case(
            "reflection beside the ball",
            &[Swap("annotations.toml", "at = [382.5, 249.5]", "at = [20.5, 30.5]")],
            "model",
            1,
            "fitting the scene to annotations.toml: corner `---` of `room` is marked as a reflection at [20.5, 30.5] in probe_04.jpg, where there is no ball",
            "mark it within the ball's outline in a photograph of the probe",
        ),
        case(
            "contradictory mark",
            &[Swap("annotations.toml", "at = [25.5, 233.5]", "at = [225.5, 33.5]")],
            "model",
            1,
            "fitting the scene to annotations.toml: the marks contradict each other by # px (rms, limit 5.0 px); the worst is corner `-+-` of `carton` in plate_000.jpg, # px off",
            r#"check this mark first; or set `lift` or `yaw` to "free""#,
        ),
        case(
            "mark is NaN",
            &[Swap("annotations.toml", "at = [25.5, 233.5]", "at = [nan, 33.5]")],
            "model",
            2,
            "./annotations.toml:124:54: nan is no number that can be measured",
            "give pixels or metres as finite numbers below a million",
        ),
        case(
            "parameter without a mark",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "floor"
kind = "ground"
[[primitive]]
name = "box"
kind = "box"
parent = "floor"
marks = [{ corner = "---", image = "plate_000.jpg", at = [39.5, 303.5] }]
"#,
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: the data do not determine the place in x of `box`, the place in z of `box`, the width of `box`, the height of `box` and the depth of `box` (condition number inf)",
            "add marks that determine it, or give its value",
        ),
        case(
            "unknown corner",
            &[Swap("annotations.toml", "corner = \"+++\"", "corner = \"++\"")],
            "model",
            1,
            "fitting the scene to annotations.toml: `room` has no corner `++`",
            "corners of boxes are like `-+-` (x, y up, z), of quads `-+`, of polygons `0`, `1`, …, of extrusions `0-` (below), `0+` (above), …, edges `---/+--`; a cylinder has `top`, `bottom`, `left`, `right`",
        ),
        case(
            "negative size",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "floor"
kind = "ground"
[[primitive]]
name = "box"
kind = "box"
parent = "floor"
size_m = [-1.0, 1.0, 1.0]
"#,
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: `box` has the size -1 m",
            "check its marks, or give its size_m",
        ),
        case(
            "sizes missing",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "box"
kind = "box"
size_m = [1.0]
"#,
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: `box` gives 1 sizes, its kind has 3",
            "give width, height, depth; 0 for what is to be fitted",
        ),
        case(
            "a polygon that crosses itself",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "rug"
kind = "polygon"
marks = [
    { corner = "0", image = "plate_000.jpg", at = [200.5, 303.5] },
    { corner = "1", image = "plate_000.jpg", at = [260.5, 333.5] },
    { corner = "2", image = "plate_000.jpg", at = [260.5, 303.5] },
    { corner = "3", image = "plate_000.jpg", at = [200.5, 333.5] },
]
"#,
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: the outline of `rug` crosses or touches itself, has no area, or has a hole outside",
            "number its corners around it, and name those of each hole in `holes`",
        ),
        case(
            "a cylinder that leans",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "room"
kind = "room"
[[primitive]]
name = "pole"
kind = "cylinder"
parent = "room"
leans_on = "back"
"#,
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: `pole` leans, which only boxes and quads can",
            "leave out its leans_on, or make it a box or a quad",
        ),
        case(
            "a mirror image of nothing",
            &[Swap(
                "annotations.toml",
                "name = \"book\"",
                "name = \"book\"\nmirror = { of = \"page\", about = \"carton\", across = \"x\" }",
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: `book` has the mirror.of `page`, which is not in the file",
            "name a primitive of the file that can serve, or leave it out",
        ),
        case(
            "a mark without weight",
            &[Swap("annotations.toml", "at = [25.5, 233.5]", "at = [25.5, 233.5], sigma_px = -1.0")],
            "model",
            1,
            "fitting the scene to annotations.toml: the mark of corner `-+-` of `carton` has the sigma_px -1",
            "give a standard deviation above 0, or leave it out",
        ),
    ]);
}
