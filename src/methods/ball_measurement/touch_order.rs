//! Order of the touches of a ball for a short machine time.

/// Order of the touches of a ball.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TouchOrder {
    /// Index of the touch that begins the touches around the ball.
    first_touch_index: usize,
    /// Whether the touches around the ball follow in falling instead of rising index order; the first touch is the
    /// same.
    is_backward: bool,
    /// Whether the pole is touched before the others; otherwise after them.
    is_pole_first: bool,
}

/// Path times of one ball, s, by indices of touches; the pole is the last.
#[derive(Debug, Clone)]
pub struct BallPathTimes {
    /// Times from each touch of the previous ball (row) to each touch (column); for the first ball one row, from the
    /// current position of the machine.
    pub from_previous_ball_s: Vec<Vec<f64>>,
    /// Times from each touch (row) to each other touch (column) of the ball.
    pub between_touches_s: Vec<Vec<f64>>,
}

impl TouchOrder {
    /// All orders: from neighbour to neighbour in either sense, from any start, with the pole first or last.
    fn all_orders(touches: usize) -> Vec<Self> {
        let firsts = 0..touches.saturating_sub(1).max(1);
        let senses = firsts.flat_map(|first| [false, true].map(|backward| (first, backward)));
        let both = |(first, backward)| {
            [false, true].map(|pole_first| Self {
                first_touch_index: first,
                is_backward: backward,
                is_pole_first: pole_first,
            })
        };
        senses.flat_map(both).collect()
    }

    /// Applies the order. `touches`: in their order around the ball, the pole last.
    pub fn apply<T>(self, mut touches: Vec<T>) -> Vec<T> {
        let Some(pole) = touches.pop() else { return touches };
        let count = touches.len().max(1);
        touches.rotate_left(self.first_touch_index % count);
        if self.is_backward {
            // The first touch remains the first.
            touches.reverse();
            touches.rotate_right(1 % count);
        }
        let at = if self.is_pole_first { 0 } else { touches.len() };
        touches.insert(at, pole);
        touches
    }
}

/// One of the touch orders of a ball, with its fastest predecessor.
struct OrderCandidate {
    touch_order: TouchOrder,
    /// The touches in this order.
    touch_indices: Vec<usize>,
    /// Shortest path time from the machine position before the first ball to the last touch of this ball in this order,
    /// s.
    shortest_time_s: f64,
    /// Index of the candidate of the previous ball on the fastest path.
    previous_candidate_index: usize,
}

/// Orders of the touches of the balls, one ball after the other, with the shortest total path time (dynamic
/// programming over the last touch of each ball).
pub fn fastest_touch_orders(balls: &[BallPathTimes]) -> Vec<TouchOrder> {
    let mut reached: Vec<Vec<OrderCandidate>> = Vec::new();
    for path_times in balls {
        let next = extend_candidates(path_times, reached.last().map_or(&[], Vec::as_slice));
        reached.push(next);
    }
    let shortest = |all: &Vec<OrderCandidate>| {
        let times = all.iter().enumerate();
        times.min_by(|a, b| a.1.shortest_time_s.total_cmp(&b.1.shortest_time_s)).map(|(number, _)| number)
    };
    let mut number = reached.last().and_then(shortest).unwrap_or_default();
    let mut chosen: Vec<TouchOrder> = Vec::new();
    for all in reached.iter().rev() {
        let Some(this) = all.get(number) else { break };
        chosen.push(this.touch_order);
        number = this.previous_candidate_index;
    }
    chosen.reverse();
    chosen
}

/// All touch orders of a ball, each with the fastest of the candidates `before` of the previous ball.
fn extend_candidates(path_times: &BallPathTimes, before: &[OrderCandidate]) -> Vec<OrderCandidate> {
    let seconds = |table: &[Vec<f64>], from: usize, to: usize| {
        table.get(from).and_then(|row| row.get(to)).copied().unwrap_or_default()
    };
    let touches = path_times.between_touches_s.len();
    let one = |around: TouchOrder| {
        let order = around.apply((0..touches).collect());
        let first = order.first().copied().unwrap_or_default();
        let pairs = order.windows(2);
        let within: f64 = pairs.map(|pair| seconds(&path_times.between_touches_s, pair[0], pair[1])).sum();
        let entered = before.iter().enumerate().map(|(number, reached)| {
            let end = reached.touch_indices.last().copied().unwrap_or_default();
            (number, reached.shortest_time_s + seconds(&path_times.from_previous_ball_s, end, first))
        });
        let (before, entered) = entered
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((0, seconds(&path_times.from_previous_ball_s, 0, first)));
        OrderCandidate {
            touch_order: around,
            touch_indices: order,
            shortest_time_s: entered + within,
            previous_candidate_index: before,
        }
    };
    TouchOrder::all_orders(touches).into_iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use estimation::random::seeded_stream;
    use rand::RngExt;

    fn total_path_time_s(balls: &[BallPathTimes], order: &[Vec<usize>]) -> f64 {
        let mut seconds = 0.0;
        for (number, touches) in order.iter().enumerate() {
            let from = number.checked_sub(1).map_or(0, |before| *order[before].last().unwrap());
            seconds += balls[number].from_previous_ball_s[from][touches[0]];
            seconds += touches.windows(2).map(|p| balls[number].between_touches_s[p[0]][p[1]]).sum::<f64>();
        }
        seconds
    }

    #[test]
    fn touches_follow_the_circle_with_the_pole_first_or_last() {
        let applied = |first, backward, pole_first| {
            let around = TouchOrder { first_touch_index: first, is_backward: backward, is_pole_first: pole_first };
            around.apply(vec!["+45", "+135", "-135", "-45", "pole"]).join(" ")
        };
        assert_eq!(applied(0, false, false), "+45 +135 -135 -45 pole");
        assert_eq!(applied(2, false, true), "pole -135 -45 +45 +135");
        assert_eq!(applied(2, true, false), "-135 +135 +45 -45 pole");
        assert!(TouchOrder::default().apply(Vec::<u8>::new()).is_empty());
        let four = TouchOrder { first_touch_index: 3, ..TouchOrder::default() }.apply(vec![1, 2, 3, 9]);
        assert_eq!(four, [1, 2, 3, 9]);
    }

    #[test]
    fn touch_order_is_the_fastest_of_all() {
        let random = &mut seeded_stream(1, &[1]);
        let mut table = |rows: usize, columns: usize| -> Vec<Vec<f64>> {
            (0..rows).map(|_| (0..columns).map(|_| random.random()).collect()).collect()
        };
        // The second ball has four accessible touches.
        let mut ball = |before, count| BallPathTimes {
            from_previous_ball_s: table(before, count),
            between_touches_s: table(count, count),
        };
        let balls = [ball(1, 5), ball(5, 4), ball(4, 5)];
        let orders = [5, 4, 5].map(|count| {
            let touches: Vec<usize> = (0..count).collect();
            let all = TouchOrder::all_orders(count).into_iter();
            all.map(|around| around.apply(touches.clone())).collect::<Vec<_>>()
        });
        let mut best = f64::INFINITY;
        for first in &orders[0] {
            for second in &orders[1] {
                for third in &orders[2] {
                    let order = [first.clone(), second.clone(), third.clone()];
                    best = best.min(total_path_time_s(&balls, &order));
                }
            }
        }
        let chosen = fastest_touch_orders(&balls);
        let order: Vec<Vec<usize>> =
            chosen.iter().zip([5, 4, 5]).map(|(around, count)| around.apply((0..count).collect())).collect();
        assert!((total_path_time_s(&balls, &order) - best).abs() < 1e-12);
    }
}
