//! Vanishing points, focal length and orientation from edges marked along three orthogonal directions (tutorial §3;
//! Caprile and Torre 1990).

use super::Problem;
use crate::camera::Intrinsics;
use crate::least_squares::{self, Loss};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Point2, Rotation3, Vector2, Vector3};

/// A marked edge, px, freed of distortion.
pub type Edge = [Point2<f64>; 2];

/// Edges along x, y (horizontal) and z (up).
#[derive(Debug, Clone, Default)]
pub struct RoomEdges {
    /// By direction.
    pub along: [Vec<Edge>; 3],
}

/// A vanishing point further away than this many image diagonals counts as infinitely far.
const FAR: f64 = 50.0;
/// A focal length less certain than this is refused …
pub(super) const MAX_RELATIVE_SIGMA: f64 = 0.1;
/// … and one that walls half a degree off the right angle would change by 9 %.
const MAX_CONDITION: f64 = 10.0;
/// A principal point less certain than this, in image diagonals, is refused.
const MAX_CENTRE_SIGMA: f64 = 0.03;
/// Marked directions are at right angles, to this, rad.
const EXACTLY_SQUARE: f64 = 1e-4;
/// Robust threshold, in standard deviations of a mark.
pub const ROBUST: f64 = 3.0;

/// Root of the smallest sum of squared distances of an edge's ends to any line through the vanishing point `v`
/// (homogeneous), signed; exact for near and infinitely far points alike. With B = Σ b bᵀ, b = w p − (x, y), it is
/// v · (p₀ × p₁) / √λmax(B).
pub fn edge_residual(v: &Vector3<f64>, [p, q]: &Edge) -> f64 {
    let through_ends = p.to_homogeneous().cross(&q.to_homogeneous());
    let [a, b] = [p, q].map(|p| p.coords * v.z - v.xy());
    let scatter: Matrix2<f64> = a * a.transpose() + b * b.transpose();
    v.dot(&through_ends) / scatter.symmetric_eigenvalues().max().sqrt()
}

/// The most likely vanishing point of edges, homogeneous and of unit length in units of `scale` px about `centre`.
pub fn vanishing_point(edges: &[Edge], centre: Point2<f64>, scale: f64) -> Result<Vector3<f64>, Problem> {
    if edges.len() < 2 {
        return Err(Problem::FewEdges { found: edges.len() });
    }
    let edges: Vec<Edge> = edges.iter().map(|e| e.map(|p| Point2::from((p - centre) / scale))).collect();
    // Algebraic start: the point nearest to all lines, long edges counting more.
    let lines: Vec<Vector3<f64>> =
        edges.iter().map(|[p, q]| p.to_homogeneous().cross(&q.to_homogeneous())).collect();
    let moments: Matrix3<f64> = lines.iter().map(|l| l * l.transpose()).sum();
    let eigen = moments.symmetric_eigen();
    let start = eigen.eigenvectors.column(eigen.eigenvalues.imin()).clone_owned();
    let basis = tangents(&start);
    let at = |x: &DVector<f64>| (start + basis[0] * x[0] + basis[1] * x[1]).normalize();
    let residuals = |x: &DVector<f64>| {
        Some(DVector::from_iterator(edges.len(), edges.iter().map(|e| edge_residual(&at(x), e))))
    };
    let names = ["the vanishing point".to_string(), "the vanishing point".to_string()];
    // Lengths are in units of the image: a threshold of 3 px at some 800 px.
    let fit = least_squares::minimise(&residuals, &names, &[0.0; 2], Loss::Huber(0.004))?;
    Ok(at(&fit.parameters))
}

fn tangents(v: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let helper = if v.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let a = v.cross(&helper).normalize();
    [a, v.cross(&a)]
}

/// Focal length and orientation from edges.
#[derive(Debug, Clone)]
pub struct EdgeFit {
    /// The room as the camera sees it.
    pub room: Room,
    /// Principal point, px, as given or as found.
    pub centre: Point2<f64>,
    /// Radial distortion k1, 0 unless it was to be found.
    pub k1: f64,
    /// Covariance of focal length (px), a turn in the camera frame (rad), principal point (px) and k1; 0 of what is given.
    pub covariance: DMatrix<f64>,
    /// By how much the focal length changes, as a share of it, where the room's directions depart from right angles by so many
    /// rad: what tells how well the vanishing points fix it.
    pub condition: f64,
    /// Distance of an edge's ends from the fit, px.
    pub rms_px: f64,
    /// The worst edge: direction, number, residual in standard deviations.
    pub worst: (usize, usize, f64),
}

impl EdgeFit {
    /// Standard deviation of the focal length, px.
    pub fn focal_sigma_px(&self) -> f64 {
        self.covariance[(0, 0)].max(0.0).sqrt()
    }

    /// Standard deviation of the principal point, in the direction in which it is known worst, px.
    pub fn centre_sigma_px(&self) -> f64 {
        self.covariance.fixed_view::<2, 2>(4, 4).symmetric_eigenvalues().max().max(0.0).sqrt()
    }

    /// Standard deviation of k1.
    pub fn k1_sigma(&self) -> f64 {
        self.covariance[(6, 6)].max(0.0).sqrt()
    }

    /// Refuses a focal length that the edges leave open.
    pub fn certain(self) -> Result<Self, Problem> {
        let relative = self.focal_sigma_px() / self.room.focal_px;
        if relative <= MAX_RELATIVE_SIGMA && self.condition <= MAX_CONDITION {
            Ok(self)
        } else {
            Err(Problem::FocalOpen { relative, condition: self.condition })
        }
    }
}

/// Focal length and orientation of a camera in a room.
#[derive(Debug, Clone, Copy)]
pub struct Room {
    /// Focal length, px.
    pub focal_px: f64,
    /// The room's directions (x, y horizontal, z up) in the camera frame.
    pub camera_from_room: Rotation3<f64>,
}

impl Room {
    /// The vanishing point of direction `k`, homogeneous, px.
    pub fn vanishing_point(&self, k: usize, centre: Point2<f64>) -> Vector3<f64> {
        self.seen(&Vector3::ith(k, 1.0), centre)
    }

    fn seen(&self, direction: &Vector3<f64>, centre: Point2<f64>) -> Vector3<f64> {
        let d = self.camera_from_room * direction;
        Vector3::new(self.focal_px * d.x + centre.x * d.z, self.focal_px * d.y + centre.y * d.z, d.z)
    }
}

/// A focal length known from elsewhere.
#[derive(Debug, Clone, Copy)]
pub struct StatedFocal {
    /// Focal length, px.
    pub focal_px: f64,
    /// Its standard deviation as a share of it.
    pub relative_sigma: f64,
}

/// What of the lens is to be found besides the focal length.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Inner {
    /// The principal point: three vanishing points at a finite distance fix it.
    pub principal_point: bool,
    /// Radial distortion k1: straight edges through one vanishing point fix it (plumb lines; Brown 1971).
    pub distortion: bool,
}

/// Fits focal length and orientation to all edges at once. The principal point is taken as known.
pub fn focal_from_edges(
    edges: &RoomEdges,
    centre: Point2<f64>,
    diagonal_px: f64,
    sigma_px: f64,
) -> Result<EdgeFit, Problem> {
    fit_edges(edges, centre, diagonal_px, sigma_px, None, Inner::default())
}

/// As [`focal_from_edges`]; a stated focal length counts as one more observation, by its standard deviation. Where more of the lens is
/// to be found, `centre` is where that starts, and edges are as they are seen.
pub fn fit_edges(
    edges: &RoomEdges,
    centre: Point2<f64>,
    diagonal_px: f64,
    sigma_px: f64,
    stated: Option<StatedFocal>,
    inner: Inner,
) -> Result<EdgeFit, Problem> {
    fit_open(edges, centre, diagonal_px, sigma_px, stated, inner)?.certain()
}

/// As [`fit_edges`], of a focal length that the edges may leave open.
pub fn fit_open(
    edges: &RoomEdges,
    centre: Point2<f64>,
    diagonal_px: f64,
    sigma_px: f64,
    stated: Option<StatedFocal>,
    inner: Inner,
) -> Result<EdgeFit, Problem> {
    let mut points = [None; 3];
    for (k, edges) in edges.along.iter().enumerate() {
        if edges.len() >= 2 {
            points[k] = Some(vanishing_point(edges, centre, diagonal_px)?);
        }
    }
    if points.iter().all(Option::is_none) {
        let found = edges.along.iter().map(Vec::len).max().unwrap_or(0);
        return Err(Problem::FewEdges { found });
    }
    let focal_px = match stated {
        Some(stated) => stated.focal_px,
        None => start_from_points(&points, diagonal_px)?,
    };
    let camera_from_room = orientation(&points, &edges.along, centre, diagonal_px, focal_px)?;
    let weighed = edges.along.each_ref().map(|edges| edges.iter().map(|e| (*e, 1.0 / sigma_px)).collect());
    let fit = Weighed { along: weighed, square_sigma: EXACTLY_SQUARE, loss: Loss::Huber(ROBUST), inner };
    let fit = fit.fit(Room { focal_px, camera_from_room }, centre, stated)?;
    let (sigma_px, limit_px) = (fit.centre_sigma_px(), MAX_CENTRE_SIGMA * diagonal_px);
    if sigma_px > limit_px { Err(Problem::CentreOpen { sigma_px, limit_px }) } else { Ok(fit) }
}

/// Edges with the square root of what each counts, 1/px, for a fit from a start near enough.
#[derive(Debug, Clone)]
struct Weighed {
    /// By direction.
    along: [Vec<(Edge, f64)>; 3],
    /// Standard deviation of the room's directions from right angles, rad.
    square_sigma: f64,
    /// How residuals count.
    loss: Loss,
    /// What else is found.
    inner: Inner,
}

/// Parameters of a fit: focal length, turn, and leanings.
const ALWAYS: usize = 10;

/// A place on an edge as a lens without distortion would show it.
fn straightened(p: &Point2<f64>, centre: Point2<f64>, focal_px: f64, k1: f64) -> Point2<f64> {
    let lens = Intrinsics { distortion: [k1, 0.0, 0.0, 0.0, 0.0], ..Intrinsics::pinhole(0, 0, focal_px) };
    let d = (p - centre) / focal_px;
    centre + Vector2::from(lens.undistort([d.x, d.y])) * focal_px
}

impl Weighed {
    /// Focal length and orientation; each direction may depart from the right angle as far as its deviation allows.
    fn fit(&self, start: Room, centre: Point2<f64>, stated: Option<StatedFocal>) -> Result<EdgeFit, Problem> {
        let room = |x: &DVector<f64>| Room {
            focal_px: start.focal_px * x[0].exp(),
            camera_from_room: Rotation3::new(Vector3::new(x[1], x[2], x[3])) * start.camera_from_room,
        };
        // Direction k leans by x[4 + 2k] and x[5 + 2k] towards the other two.
        let leaning = |x: &DVector<f64>, k: usize| {
            let mut d = Vector3::ith(k, 1.0);
            (d[(k + 1) % 3], d[(k + 2) % 3]) = (x[4 + 2 * k], x[5 + 2 * k]);
            d
        };
        let Inner { principal_point, distortion } = self.inner;
        let moved = |x: &DVector<f64>| match principal_point {
            true => centre + Vector2::new(x[ALWAYS], x[ALWAYS + 1]),
            false => centre,
        };
        let k1 = |x: &DVector<f64>| if distortion { x[x.len() - 1] } else { 0.0 };
        let residuals = |x: &DVector<f64>| {
            let (room, centre, k1) = (room(x), moved(x), k1(x));
            let edges = self.along.iter().enumerate().flat_map(|(k, edges)| {
                let v = room.seen(&leaning(x, k), centre);
                edges.iter().map(move |(edge, weight)| {
                    let straight = |p: &Point2<f64>| straightened(p, centre, room.focal_px, k1);
                    let edge = if distortion { &edge.each_ref().map(straight) } else { edge };
                    edge_residual(&v, edge) * weight
                })
            });
            let stated = stated.map(|s| (room.focal_px / s.focal_px).ln() / s.relative_sigma);
            let square = (4..ALWAYS).map(|k| x[k] / self.square_sigma);
            Some(DVector::from_vec(square.chain(stated).chain(edges).collect()))
        };
        let lean = "a direction's departure from the right angle";
        let names = ["the focal length", "the tilt", "the tilt", "the roll"].into_iter().chain([lean; 6]);
        let names = names.chain(["the principal point"; 2].into_iter().filter(|_| principal_point));
        let names: Vec<String> =
            names.chain(Some("the distortion").filter(|_| distortion)).map(String::from).collect();
        let fit = least_squares::minimise(&residuals, &names, &vec![0.0; names.len()], self.loss)?;
        let (room, centre, k1) = (room(&fit.parameters), moved(&fit.parameters), k1(&fit.parameters));
        // Where the parameters of the covariance stand among those fitted.
        let mut stand: Vec<(usize, usize)> = (0..4).map(|k| (k, k)).collect();
        stand.extend((0..2).filter(|_| principal_point).map(|k| (4 + k, ALWAYS + k)));
        stand.extend(Some((6, names.len() - 1)).filter(|_| distortion));
        let mut covariance = DMatrix::zeros(7, 7);
        for ((i, a), (j, b)) in stand.iter().flat_map(|a| stand.iter().map(move |b| (a, b))) {
            covariance[(*i, *j)] = fit.covariance[(*a, *b)];
        }
        covariance.row_mut(0).scale_mut(room.focal_px);
        covariance.column_mut(0).scale_mut(room.focal_px);
        let others = 6 + usize::from(stated.is_some());
        let of_edges = fit.residuals.rows(others, fit.residuals.len() - others);
        let misses =
            self.along.iter().flatten().zip(of_edges.iter()).map(|((_, weight), r)| (r / weight).powi(2));
        let worst = of_edges.iamax();
        let (mut axis, mut number) = (0, worst);
        while number >= self.along[axis].len() {
            number -= self.along[axis].len();
            axis += 1;
        }
        Ok(EdgeFit {
            room,
            centre,
            k1,
            covariance,
            condition: fit.gain.view((0, 0), (1, 6)).norm() / self.square_sigma,
            rms_px: (misses.sum::<f64>() / of_edges.len().max(1) as f64).sqrt(),
            worst: (axis, number, of_edges[worst].abs()),
        })
    }
}

/// f² = −v · v′ with v relative to the principal point, from the pair of finite vanishing points that gives it best.
fn start_from_points(points: &[Option<Vector3<f64>>; 3], diagonal_px: f64) -> Result<f64, Problem> {
    let finite: Vec<Vector2<f64>> =
        points.iter().flatten().filter(|v| v.xy().norm() < FAR * v.z.abs()).map(|v| v.xy() / v.z).collect();
    if finite.len() < 2 {
        return Err(Problem::FewVanishingPoints {
            finite: finite.len(),
            marked: points.iter().flatten().count(),
        });
    }
    let pairs = (0..finite.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
    // A pair is the better, the nearer its points.
    let best = pairs
        .map(|(a, b)| (-finite[a].dot(&finite[b]), finite[a].norm() * finite[b].norm()))
        .filter(|(f2, size)| *f2 > 1e-3 * size)
        .min_by(|a, b| a.1.total_cmp(&b.1));
    match best {
        Some((f2, _)) => Ok(f2.sqrt() * diagonal_px),
        None => {
            Err(Problem::NegativeFocal { f2_px2: -finite[0].dot(&finite[1]) * diagonal_px * diagonal_px })
        }
    }
}

/// Orientation from vanishing points: z points up in the picture, x along its marks, y completes a right-handed frame.
fn orientation(
    points: &[Option<Vector3<f64>>; 3],
    edges: &[Vec<Edge>; 3],
    centre: Point2<f64>,
    scale: f64,
    focal_px: f64,
) -> Result<Rotation3<f64>, Problem> {
    let direction = |k: usize| {
        let v = points[k]?;
        // Vanishing points are in units of `scale` about the centre: K⁻¹ v.
        let d = Vector3::new(v.x * scale, v.y * scale, v.z * focal_px).normalize();
        let seen = |p: &Point2<f64>| (d.xy() * focal_px - (p - centre) * d.z).normalize();
        let votes: f64 = match k {
            2 => -seen(&centre).y,
            _ => edges[k].iter().map(|[p, q]| (q - p).dot(&seen(&nalgebra::center(p, q))).signum()).sum(),
        };
        Some(if votes < 0.0 { -d } else { d })
    };
    let [x, y, z] = match [direction(0), direction(1), direction(2)] {
        [Some(x), _, Some(z)] => [x, z.cross(&x), z],
        [None, Some(y), Some(z)] => [y.cross(&z), y, z],
        [Some(x), Some(y), None] => {
            let z = x.cross(&y);
            if z.y < 0.0 { [x, y, z] } else { [x, -y, -z] }
        }
        _ => return Err(Problem::FewEdges { found: 0 }),
    };
    let svd = Matrix3::from_columns(&[x, y, z]).svd(true, true);
    let (u, v) = svd.u.zip(svd.v_t).ok_or(Problem::FewEdges { found: 0 })?;
    let sign = Vector3::new(1.0, 1.0, (u * v).determinant().signum());
    Ok(Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&sign) * v))
}

/// What places a camera whose orientation is known (tutorial §3); px are freed of distortion.
#[derive(Debug, Clone, Copy)]
pub enum Placing {
    /// Marks of the origin and of a known length.
    Marks {
        /// Where the origin is seen.
        origin: Point2<f64>,
        /// Start, on the plane z = 0, and end of the known length.
        length: Edge,
        /// Along which direction.
        axis: usize,
        /// Length, m.
        length_m: f64,
    },
    /// The camera's height over the plane z = 0.
    Height {
        /// Where the origin is seen.
        looks_at: Point2<f64>,
        /// Height, m.
        height_m: f64,
    },
}

impl Placing {
    /// The same with marks shifted, px: of the origin, the length's start and its end.
    fn shifted(&self, by: &[Vector2<f64>; 3]) -> Self {
        match *self {
            Self::Marks { origin, length: [from, to], axis, length_m } => {
                Self::Marks { origin: origin + by[0], length: [from + by[1], to + by[2]], axis, length_m }
            }
            // Nothing is marked.
            height => height,
        }
    }
}

/// Where the camera is in the room's frame (z up), m.
pub fn camera_centre(
    placing: &Placing,
    focal_px: f64,
    centre: Point2<f64>,
    camera_from_room: &Rotation3<f64>,
) -> Result<Vector3<f64>, Problem> {
    let ray = |p: Point2<f64>| {
        let d = (p - centre) / focal_px;
        camera_from_room.inverse() * Vector3::new(d.x, d.y, 1.0)
    };
    match *placing {
        Placing::Height { looks_at, height_m } => {
            let origin = ray(looks_at);
            if origin.z < 0.0 { Ok(origin * (height_m / origin.z)) } else { Err(Problem::NoFloor) }
        }
        Placing::Marks { origin, length: [from, to], axis, length_m } => {
            let [origin, from, to] = [origin, from, to].map(ray);
            // With the origin at depth 1 the plane z = 0 lies at `origin.z` below the camera.
            let on_plane = from * (origin.z / from.z);
            let axis = Vector3::ith(axis, 1.0);
            // The point of the axis line through `on_plane` nearest to the end's ray.
            let normal = to.cross(&axis.cross(&to));
            let length = -on_plane.dot(&normal) / axis.dot(&normal);
            let scale = length_m / length;
            let ok = scale.is_finite() && scale > 0.0 && origin.z < 0.0 && from.z < 0.0;
            if ok { Ok(-origin * scale) } else { Err(Problem::ScaleMarks { relative_length: length }) }
        }
    }
}

/// How the camera centre (rows, m) follows what the edges' fit found, in the order of its covariance, and the marks that place it (px,
/// two each), and the covariance of all these.
pub fn camera_centre_errors(
    placing: &Placing,
    fit: &EdgeFit,
    centre: Point2<f64>,
    sigma_px: f64,
) -> Result<(DMatrix<f64>, DMatrix<f64>), Problem> {
    let at = |x: &[f64; 13]| {
        let moved = placing.shifted(&[7, 9, 11].map(|k| Vector2::new(x[k], x[k + 1])));
        let turn = Rotation3::new(Vector3::new(x[1], x[2], x[3]));
        let centre = centre + Vector2::new(x[4], x[5]);
        camera_centre(&moved, fit.room.focal_px + x[0], centre, &(turn * fit.room.camera_from_room))
    };
    let mut jacobian = DMatrix::zeros(3, 13);
    // Distortion (6) hardly moves the marks, which lie near the middle.
    for k in (0..13).filter(|k| *k != 6) {
        let h = if k == 0 || k > 3 { 1e-3 } else { 1e-6 };
        let (mut up, mut down) = ([0.0; 13], [0.0; 13]);
        (up[k], down[k]) = (h, -h);
        jacobian.set_column(k, &((at(&up)? - at(&down)?) / (2.0 * h)));
    }
    let mut covariance = DMatrix::identity(13, 13) * (sigma_px * sigma_px);
    covariance.view_mut((0, 0), (7, 7)).copy_from(&fit.covariance);
    Ok((jacobian, covariance))
}
