//! Tests whether two lists of numbers differ: paired, and unpaired for comparison with the paper's figures.

use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// Up to so many differences without ties the distribution of Wilcoxon's statistic is computed exactly.
const EXACT: usize = 50;

/// Two-sided p of Wilcoxon's signed-rank test. Differences of 0 are left out; ties share their ranks. Exact for up to 50
/// differences without ties, else by the normal approximation with the correction for ties and none for continuity, as
/// SciPy's `wilcoxon` does it. `None` when all differences are 0.
pub fn wilcoxon(differences: &[f64]) -> Option<f64> {
    let mut sorted: Vec<f64> = differences.iter().copied().filter(|d| *d != 0.0).collect();
    sorted.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let n = sorted.len();
    if n == 0 {
        return None;
    }
    let (mut plus, mut ties, mut at) = (0.0, 0.0, 0);
    while at < n {
        let same = sorted[at..]
            .iter()
            .take_while(|d| d.abs() == sorted[at].abs())
            .count();
        let rank = (2 * at + 1 + same) as f64 / 2.0;
        plus += rank * sorted[at..at + same].iter().filter(|d| **d > 0.0).count() as f64;
        ties += (same * (same * same - 1)) as f64;
        at += same;
    }
    let all = (n * (n + 1)) as f64 / 2.0;
    if n <= EXACT && ties == 0.0 && n == differences.len() {
        return Some(exact(n, plus.min(all - plus) as usize));
    }
    let mean = all / 2.0;
    let variance = (n * (n + 1) * (2 * n + 1)) as f64 / 24.0 - ties / 48.0;
    let z = (plus - mean) / variance.sqrt();
    let normal = Normal::standard();
    Some((2.0 * normal.cdf(-z.abs())).min(1.0))
}

/// P(min(W⁺, W⁻) ≤ w) when each of n ranks has either sign with equal probability.
fn exact(n: usize, w: usize) -> f64 {
    let all = n * (n + 1) / 2;
    // Probability of each sum of positive ranks.
    let mut probability = vec![0.0; all + 1];
    probability[0] = 1.0;
    for rank in 1..=n {
        for sum in (0..=all).rev() {
            let with = if sum >= rank { probability[sum - rank] } else { 0.0 };
            probability[sum] = 0.5 * (probability[sum] + with);
        }
    }
    let tail: f64 = probability.iter().take(w + 1).sum();
    (2.0 * tail).min(1.0)
}

/// Two-sided p of the paired t-test. `None` with fewer than two differences, or when all are alike.
pub fn paired_t(differences: &[f64]) -> Option<f64> {
    let (mean, variance) = moments(differences)?;
    let n = differences.len() as f64;
    t_test(mean / (variance / n).sqrt(), n - 1.0)
}

/// Two-sided p of Welch's unpaired t-test. `None` when one side has fewer than two numbers, or all numbers are alike.
pub fn welch(a: &[f64], b: &[f64]) -> Option<f64> {
    let ((mean_a, var_a), (mean_b, var_b)) = (moments(a)?, moments(b)?);
    let (share_a, share_b) = (var_a / a.len() as f64, var_b / b.len() as f64);
    let t = (mean_a - mean_b) / (share_a + share_b).sqrt();
    let freedom = (share_a + share_b).powi(2)
        / (share_a.powi(2) / (a.len() - 1) as f64 + share_b.powi(2) / (b.len() - 1) as f64);
    t_test(t, freedom)
}

fn t_test(t: f64, freedom: f64) -> Option<f64> {
    if !t.is_finite() {
        return None;
    }
    let student = StudentsT::new(0.0, 1.0, freedom).ok()?;
    Some((2.0 * student.cdf(-t.abs())).min(1.0))
}

/// Mean and variance (n − 1).
fn moments(values: &[f64]) -> Option<(f64, f64)> {
    if values.len() < 2 {
        return None;
    }
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    Some((mean, squares / (n - 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: [f64; 10] = [0.82, 0.41, 0.57, 0.28, 0.66, 0.91, 0.35, 0.73, 0.49, 0.60];
    const B: [f64; 10] = [0.85, 0.52, 0.55, 0.47, 0.70, 0.92, 0.50, 0.80, 0.61, 0.58];

    fn differences() -> Vec<f64> {
        A.iter().zip(B).map(|(a, b)| a - b).collect()
    }

    fn near(found: Option<f64>, want: f64) {
        let found = found.unwrap();
        assert!(
            (found - want).abs() < 1e-9 * want.max(1e-3),
            "{found} instead of {want}"
        );
    }

    #[test]
    fn as_scipy_has_them() {
        // scipy.stats.ttest_rel, ttest_ind(equal_var=False)
        near(paired_t(&differences()), 0.015687293712808782);
        near(welch(&A, &B), 0.4172660972927468);
        // wilcoxon, exact: no ties
        let d = [0.3, -0.1, 0.45, 0.21, -0.05, 0.6, 0.33, 0.12];
        near(wilcoxon(&d), 0.0390625);
        // wilcoxon, approximate: ties and zeros
        let d = [1.0, 2.0, 2.0, -1.0, 3.0, 0.0, 4.0, -2.0, 5.0, 5.0, 0.0, 1.0];
        near(wilcoxon(&d), 0.035564379058193644);
    }

    #[test]
    fn without_differences_there_is_nothing_to_test() {
        assert_eq!((wilcoxon(&[0.0, 0.0]), wilcoxon(&[])), (None, None));
        assert_eq!((paired_t(&[0.1, 0.1]), paired_t(&[0.1])), (None, None));
        assert_eq!(
            (welch(&[1.0], &[1.0, 2.0]), welch(&[1.0, 1.0], &[1.0, 1.0])),
            (None, None)
        );
        assert_eq!(wilcoxon(&[0.5]), Some(1.0));
        assert_eq!(exact(3, 0), 0.25);
    }
}
