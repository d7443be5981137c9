//! The grey histogram of a volume, and modes and thresholds in it.

use serde::Serialize;

/// Counts of grey values in equal bins between `low` and `high`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Histogram {
    /// Lower end of the first bin.
    pub low: f64,
    /// Upper end of the last bin.
    pub high: f64,
    /// Count, or summed weight, per bin.
    pub counts: Vec<f64>,
}

impl Histogram {
    /// An empty histogram. `high` must be above `low`.
    #[must_use]
    pub fn new(low: f64, high: f64, bins: usize) -> Self {
        Self { low, high, counts: vec![0.0; bins] }
    }

    /// Width of a bin.
    #[must_use]
    pub fn bin_width(&self) -> f64 {
        (self.high - self.low) / self.counts.len() as f64
    }

    /// The bin of a value; values beyond the ends go to the first and last bin.
    #[must_use]
    pub fn bin(&self, value: f64) -> usize {
        (((value - self.low) / self.bin_width()).max(0.0) as usize).min(self.counts.len() - 1)
    }

    /// The value in the middle of a bin.
    #[must_use]
    pub fn value(&self, bin: usize) -> f64 {
        self.low + (bin as f64 + 0.5) * self.bin_width()
    }

    /// The value below which a `share` (0 to 1) of the total lies.
    #[must_use]
    pub fn quantile(&self, share: f64) -> f64 {
        let wanted = share * self.counts.iter().sum::<f64>();
        let mut sum = 0.0;
        for (bin, &count) in self.counts.iter().enumerate() {
            if sum + count >= wanted && count > 0.0 {
                let part = ((wanted - sum) / count).clamp(0.0, 1.0);
                return self.low + (bin as f64 + part) * self.bin_width();
            }
            sum += count;
        }
        self.high
    }

    /// Smoothed by a Gaussian of `sigma` bins, mirrored at the ends.
    #[must_use]
    pub fn smoothed(&self, sigma: f64) -> Self {
        let n = self.counts.len() as isize;
        let reach = (4.0 * sigma).ceil() as isize;
        let kernel: Vec<f64> = (-reach..=reach).map(|d| (-0.5 * (d as f64 / sigma).powi(2)).exp()).collect();
        let norm: f64 = kernel.iter().sum();
        let mirrored = |i: isize| {
            let i = i.rem_euclid(2 * n);
            self.counts[(if i < n { i } else { 2 * n - 1 - i }) as usize]
        };
        let at = |i: isize| kernel.iter().zip(-reach..).map(|(k, d)| k * mirrored(i + d)).sum::<f64>() / norm;
        Self { counts: (0..n).map(at).collect(), ..self.clone() }
    }

    /// Bins of local maxima whose logarithm rises at least `prominence` above the higher of the
    /// two valleys that separate it from higher ground.
    #[must_use]
    pub fn modes(&self, prominence: f64) -> Vec<usize> {
        // Empty bins count as a billionth of the total, so that a logarithm exists.
        let floor = 1e-9 * self.counts.iter().sum::<f64>();
        let log: Vec<f64> = self.counts.iter().map(|c| (c + floor).ln()).collect();
        let n = log.len();
        (0..n)
            .filter(|&i| (i == 0 || log[i] > log[i - 1]) && (i + 1 == n || log[i] >= log[i + 1]))
            .filter(|&i| {
                let depth = |side: &mut dyn Iterator<Item = usize>| {
                    let mut lowest = log[i];
                    for j in side {
                        if log[j] > log[i] {
                            return Some(log[i] - lowest);
                        }
                        lowest = lowest.min(log[j]);
                    }
                    None // no higher ground on this side
                };
                let sides = [depth(&mut (0..i).rev()), depth(&mut (i + 1..n))];
                sides.into_iter().flatten().all(|d| d >= prominence)
            })
            .collect()
    }

    /// Multi-level Otsu: the means of `classes` classes that maximise the variance between them
    /// (Otsu 1979; Li et al. §2.2 for two), by dynamic programming over the bins.
    #[must_use]
    pub fn otsu_means(&self, classes: usize) -> Vec<f64> {
        let n = self.counts.len();
        let (mut weight, mut first) = (vec![0.0; n + 1], vec![0.0; n + 1]);
        for (i, &c) in self.counts.iter().enumerate() {
            weight[i + 1] = weight[i] + c;
            first[i + 1] = first[i] + c * self.value(i);
        }
        // What a class of the bins a..b adds to the between-class variance.
        let gain = |a: usize, b: usize| {
            let w = weight[b] - weight[a];
            if w > 0.0 { (first[b] - first[a]).powi(2) / w } else { 0.0 }
        };
        let mut best = vec![vec![f64::NEG_INFINITY; n + 1]; classes + 1];
        let mut cut = vec![vec![0; n + 1]; classes + 1];
        best[0][0] = 0.0;
        for k in 1..=classes {
            for b in k..=n {
                for a in k - 1..b {
                    let value = best[k - 1][a] + gain(a, b);
                    if value > best[k][b] {
                        (best[k][b], cut[k][b]) = (value, a);
                    }
                }
            }
        }
        let mut means = Vec::with_capacity(classes);
        let mut end = n;
        for k in (1..=classes).rev() {
            let start = cut[k][end];
            let w = weight[end] - weight[start];
            means.push(if w > 0.0 { (first[end] - first[start]) / w } else { self.value(start) });
            end = start;
        }
        means.reverse();
        means
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_humps() -> Histogram {
        let hump = |x: f64, at: f64, s: f64| (-0.5 * ((x - at) / s).powi(2)).exp();
        let counts =
            (0..100).map(|i| 1000.0 * hump(f64::from(i), 20.0, 4.0) + 300.0 * hump(f64::from(i), 70.0, 6.0));
        Histogram { low: 0.0, high: 200.0, counts: counts.collect() }
    }

    #[test]
    fn modes_and_otsu_find_two_humps() {
        let h = two_humps();
        assert_eq!(h.modes(0.5), [20, 70]);
        let means = h.otsu_means(2);
        assert!((means[0] - 41.0).abs() < 1.0 && (means[1] - 141.0).abs() < 1.0, "{means:?}");
        assert!((h.quantile(0.5) - h.quantile(0.49999)).abs() < 0.1);
    }
}
