// Rays against triangles in a binary hierarchy: `Bvh::any_hit` and `Bvh::occluded` in src/visibility.rs.
#define_import_path insitu::rays

struct Node {
    low: vec3<f32>,
    count: u32,   // of triangles; 0: two nodes lie below
    high: vec3<f32>,
    first: u32,   // of its triangles, or of the nodes below
}

struct Triangle {
    a: vec3<f32>,
    padding_a: u32,
    b: vec3<f32>,
    padding_b: u32,
    c: vec3<f32>,
    padding_c: u32,
}

@group(0) @binding(2) var<storage, read> nodes: array<Node>;
@group(0) @binding(3) var<storage, read> triangles: array<Triangle>;

const NOTHING: u32 = 0xffffffffu;
// Most nodes that wait: a deeper hierarchy is refused.
const DEPTH: u32 = 64u;

fn crosses(node: u32, origin: vec3<f32>, inverse: vec3<f32>, range: vec2<f32>) -> bool {
    let a = (nodes[node].low - origin) * inverse;
    let b = (nodes[node].high - origin) * inverse;
    let near = min(a, b);
    let far = max(a, b);
    let enter = max(max(near.x, near.y), max(near.z, range.x));
    let leave = min(min(far.x, far.y), min(far.z, range.y));
    // Rounding must not lose what a box just holds.
    return enter <= leave * (1.0 + 1e-6) + 1e-7;
}

// Möller and Trumbore 1997.
fn meets(triangle: u32, origin: vec3<f32>, direction: vec3<f32>, range: vec2<f32>) -> bool {
    let a = triangles[triangle].a;
    let e1 = a - triangles[triangle].b;
    let e2 = triangles[triangle].c - a;
    let n = cross(e1, e2);
    let along = dot(n, direction);
    if along == 0.0 {
        return false;
    }
    let c = a - origin;
    let r = cross(direction, c);
    let u = dot(r, e2) / along;
    let v = dot(r, e1) / along;
    let t = dot(n, c) / along;
    return u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= range.x && t <= range.y;
}

// Whether anything below a root lies on the ray within a range, in lengths of its direction.
fn any_hit(root: u32, origin: vec3<f32>, direction: vec3<f32>, range: vec2<f32>) -> bool {
    if root == NOTHING {
        return false;
    }
    let tiny = vec3<f32>(1e-20);
    let inverse = 1.0 / select(direction, tiny, abs(direction) < tiny);
    var waiting: array<u32, DEPTH>;
    waiting[0] = root;
    var count = 1u;
    while count > 0u {
        count -= 1u;
        let node = waiting[count];
        if !crosses(node, origin, inverse, range) {
            continue;
        }
        if nodes[node].count == 0u {
            waiting[count] = nodes[node].first;
            waiting[count + 1u] = nodes[node].first + 1u;
            count += 2u;
            continue;
        }
        for (var i = 0u; i < nodes[node].count; i++) {
            if meets(nodes[node].first + i, origin, direction, range) {
                return true;
            }
        }
    }
    return false;
}
