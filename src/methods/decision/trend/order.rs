//! A clock may be set, or lose its battery: the order of the runs stands, their times may not.

use super::Point;

/// The times that agree with the order, as many as can, stay; each other becomes that of the last one before
/// it that stays, or of the first that stays. One run from 1970 or from 2099 moves none but itself.
pub(super) fn mend(points: &mut [Point]) {
    let stays = longest(points);
    let first = stays.iter().position(|stays| *stays).and_then(|index| points.get(index));
    let Some(mut last) = first.map(|point| point.t_s) else { return };
    for (point, stays) in points.iter_mut().zip(stays) {
        if stays {
            last = point.t_s;
        }
        point.t_s = last;
    }
}

/// Of each point whether it is in the longest row of points whose times do not step back. There are some
/// hundreds of points at most, so each is compared with all before it.
fn longest(points: &[Point]) -> Vec<bool> {
    // How long a row that ends here can be, and which point comes before it.
    let mut rows: Vec<(usize, Option<usize>)> = Vec::with_capacity(points.len());
    for point in points {
        let fits = points.iter().zip(&rows).enumerate();
        let fits = fits.filter(|(_, (before, _))| before.t_s <= point.t_s);
        let best = fits.map(|(index, (_, (length, _)))| (*length, Some(index))).max();
        let (length, before) = best.unwrap_or((0, None));
        rows.push((length + 1, before));
    }
    let mut at = (0..rows.len()).max_by_key(|index| rows.get(*index).map(|(length, _)| *length));
    let mut stays = vec![false; points.len()];
    while let Some(index) = at {
        stays.iter_mut().skip(index).take(1).for_each(|stays| *stays = true);
        at = rows.get(index).and_then(|(_, before)| *before);
    }
    stays
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mended(times: &[f64]) -> Vec<f64> {
        let mut points: Vec<Point> =
            times.iter().map(|t_s| Point { t_s: *t_s, value: 0.0 }).collect();
        mend(&mut points);
        points.iter().map(|point| point.t_s).collect()
    }

    #[test]
    fn a_wrong_clock_moves_only_its_own_runs() {
        assert!(mended(&[]).is_empty());
        assert_eq!(mended(&[3.0, 4.0, 4.0, 5.0]), [3.0, 4.0, 4.0, 5.0]);
        // The clock's battery is empty, at the end, at the beginning and between; and one far ahead.
        assert_eq!(mended(&[10.0, 20.0, 30.0, 0.0]), [10.0, 20.0, 30.0, 30.0]);
        assert_eq!(mended(&[99.0, 10.0, 20.0, 30.0]), [10.0, 10.0, 20.0, 30.0]);
        assert_eq!(mended(&[10.0, 12.0, 14.0, 0.0, 1.0, 20.0])[2..5], [14.0, 14.0, 14.0]);
        assert_eq!(mended(&[10.0, 99.0, 20.0, 30.0]), [10.0, 10.0, 20.0, 30.0]);
        // Set back for good: the newer ones count once they are more.
        assert_eq!(mended(&[90.0, 91.0, 10.0, 11.0, 12.0]), [10.0, 10.0, 10.0, 11.0, 12.0]);
    }
}
