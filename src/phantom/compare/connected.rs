//! Which vertices hang together through triangles.

/// For each of `vertices`, the lowest vertex connected with it by `triangles`; itself if none touches it.
pub(super) fn lowest_connected(vertices: usize, triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..vertices as u32).collect();
    for [a, b, c] in triangles {
        for (p, q) in [(*a, *b), (*b, *c)] {
            let (p, q) = (root(&mut parent, p), root(&mut parent, q));
            parent[p.max(q) as usize] = p.min(q);
        }
    }
    (0..vertices as u32).map(|v| root(&mut parent, v)).collect()
}

fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        parent[v as usize] = parent[parent[v as usize] as usize];
        v = parent[v as usize];
    }
    v
}
