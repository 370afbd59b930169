//! Correction of wrong clock times: the order of the runs is reliable, their times may not be, because a
//! clock may be set or lose its battery.

use super::TrendPoint;

/// Keeps the largest set of times that agrees with the order. Each other time is replaced by the last kept
/// time before it, or by the first kept time. One run dated 1970 or 2099 changes only its own time.
pub(super) fn correct_times(points: &mut [TrendPoint]) {
    let is_kept = longest_ordered_subset(points);
    let first = is_kept.iter().position(|is_kept| *is_kept).and_then(|index| points.get(index));
    let Some(mut last) = first.map(|point| point.measurement_time_s) else { return };
    for (point, is_kept) in points.iter_mut().zip(is_kept) {
        if is_kept {
            last = point.measurement_time_s;
        }
        point.measurement_time_s = last;
    }
}

/// Whether each point belongs to the longest sequence of points with non-decreasing times. There are at most
/// some hundreds of points, so each is compared with all before it.
fn longest_ordered_subset(points: &[TrendPoint]) -> Vec<bool> {
    // Length of the longest sequence that ends at each point, and the index of its previous point.
    let mut rows: Vec<(usize, Option<usize>)> = Vec::with_capacity(points.len());
    for point in points {
        let fits = points.iter().zip(&rows).enumerate();
        let fits = fits.filter(|(_, (before, _))| before.measurement_time_s <= point.measurement_time_s);
        let best = fits.map(|(index, (_, (length, _)))| (*length, Some(index))).max();
        let (length, before) = best.unwrap_or((0, None));
        rows.push((length + 1, before));
    }
    let mut at = (0..rows.len()).max_by_key(|index| rows.get(*index).map(|(length, _)| *length));
    let mut is_kept = vec![false; points.len()];
    while let Some(index) = at {
        is_kept.iter_mut().skip(index).take(1).for_each(|is_kept| *is_kept = true);
        at = rows.get(index).and_then(|(_, before)| *before);
    }
    is_kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corrected_times(times: &[f64]) -> Vec<f64> {
        let mut points: Vec<TrendPoint> =
            times.iter().map(|t_s| TrendPoint { measurement_time_s: *t_s, value: 0.0 }).collect();
        correct_times(&mut points);
        points.iter().map(|point| point.measurement_time_s).collect()
    }

    #[test]
    fn wrong_clock_shifts_only_its_own_runs() {
        assert!(corrected_times(&[]).is_empty());
        assert_eq!(corrected_times(&[3.0, 4.0, 4.0, 5.0]), [3.0, 4.0, 4.0, 5.0]);
        // The clock battery was empty at the end, at the beginning and in between; one clock was far ahead.
        assert_eq!(corrected_times(&[10.0, 20.0, 30.0, 0.0]), [10.0, 20.0, 30.0, 30.0]);
        assert_eq!(corrected_times(&[99.0, 10.0, 20.0, 30.0]), [10.0, 10.0, 20.0, 30.0]);
        assert_eq!(corrected_times(&[10.0, 12.0, 14.0, 0.0, 1.0, 20.0])[2..5], [14.0, 14.0, 14.0]);
        assert_eq!(corrected_times(&[10.0, 99.0, 20.0, 30.0]), [10.0, 10.0, 20.0, 30.0]);
        // The clock was set back permanently: the newer times are kept as soon as there are more of them.
        assert_eq!(corrected_times(&[90.0, 91.0, 10.0, 11.0, 12.0]), [10.0, 10.0, 10.0, 11.0, 12.0]);
    }
}
