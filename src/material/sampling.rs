//! Which voxels are looked at where looking at all would cost more than it tells.

/// Interior voxels (those with a full 3 x 3 x 3 neighbourhood) on a regular grid of about `wanted`
/// points: the same points for any number of threads. Empty if an axis has fewer than 3 voxels.
pub(super) fn interior_grid(size: [usize; 3], wanted: usize) -> Vec<[usize; 3]> {
    if size.iter().any(|&n| n < 3) {
        return Vec::new();
    }
    let points = |stride: usize| size.iter().map(|&n| (n - 2).div_ceil(stride)).product::<usize>();
    let longest = size.into_iter().max().unwrap_or(1);
    let stride = (1..longest).find(|&stride| points(stride) <= wanted).unwrap_or(longest);
    let axis = |n: usize| (1..n - 1).step_by(stride);
    axis(size[2])
        .flat_map(|z| axis(size[1]).flat_map(move |y| axis(size[0]).map(move |x| [x, y, z])))
        .collect()
}

/// Position of a voxel in a volume of `size`, x fastest.
pub(super) fn position(size: [usize; 3], [x, y, z]: [usize; 3]) -> usize {
    (z * size[1] + y) * size[0] + x
}

/// Position offsets of the 27 voxels of a 3 x 3 x 3 neighbourhood.
pub(super) fn neighbourhood(size: [usize; 3]) -> [isize; 27] {
    std::array::from_fn(|i| {
        let [dx, dy, dz] = [i % 3, i / 3 % 3, i / 9].map(|d| d as isize - 1);
        (dz * size[1] as isize + dy) * size[0] as isize + dx
    })
}
