//! Harmonics of the measured revolutions: their means, and their scatter between revolutions.

use std::f64::consts::TAU;

use faer::{Mat, c64};

use super::shared_revolutions::{ChannelAtIndex, ChannelRevolutions};

/// Minimum degrees of freedom of a harmonic's scatter. It is pooled with neighbouring harmonics up to this number,
/// with which the expanded uncertainty is within 5 % of that of a known scatter.
const MIN_POOLED_DOF: f64 = 30.0;
/// Smallest standard uncertainty of a harmonic, mm. It is below the resolution of any sensor and above rounding.
const MIN_SIGMA_MM: f64 = 1e-9;

/// Covariance between channels, mm², of the cosine or sine part of one harmonic in one revolution.
#[derive(Debug, Clone)]
pub struct HarmonicScatter {
    pub covariance: Mat<f64>,
    pub dof: f64,
}

/// Harmonics of all rows with their scatter: the input of the estimation.
#[derive(Debug, Clone)]
pub struct HarmonicData {
    pub rows: Vec<ChannelAtIndex>,
    /// Number of revolutions in the mean of each row.
    pub revolution_counts: Vec<usize>,
    /// Mean of M_k over the revolutions, mm: harmonics (from order 1) × rows.
    pub harmonic_means: Vec<Vec<c64>>,
    /// Scatter of each harmonic.
    pub scatters: Vec<HarmonicScatter>,
}

/// Basis for M_k of the harmonics 1..=`orders` of samples at equal angles that start at 0: samples × e^(−ikq)·2/T,
/// as one matrix product for many revolutions.
pub struct HarmonicBasis(Mat<c64>);

impl HarmonicBasis {
    pub fn new(samples: usize, orders: usize) -> Self {
        let factor = 2.0 / samples as f64;
        let phase = |i: usize, order: usize| -TAU * ((i * order) % samples) as f64 / samples as f64;
        Self(Mat::from_fn(samples, orders, |i, j| c64::cis(phase(i, j + 1)) * factor))
    }

    /// Harmonics of one revolution, from order 1.
    pub fn harmonics(&self, samples: &[f64]) -> Vec<c64> {
        let Self(basis) = self;
        let column = |j: usize| basis.col_as_slice(j).iter().zip(samples);
        (0..basis.ncols()).map(|j| column(j).map(|(b, sample)| b * sample).sum()).collect()
    }
}

impl HarmonicData {
    /// Computes the harmonics 1..=`orders` of the revolutions, and the scatter from the differences between
    /// revolutions.
    ///
    /// # Errors
    /// Fewer than two revolutions at every index; rows that are inconsistent with each other; fewer than 2·`orders`
    /// + 1 samples per revolution.
    pub fn from_revolutions(measured: &[ChannelRevolutions], orders: usize) -> Result<Self, RevolutionsError> {
        check_revolutions(measured, orders)?;
        let samples = measured[0].revolutions[0].len();
        let basis = HarmonicBasis::new(samples, orders);
        let harmonics = |row: &ChannelRevolutions| -> Vec<Vec<c64>> {
            row.revolutions.iter().map(|samples| basis.harmonics(samples)).collect()
        };
        let all: Vec<Vec<Vec<c64>>> = measured.iter().map(harmonics).collect();
        let mean = |of: &Vec<Vec<c64>>, k: usize| {
            of.iter().map(|revolution| revolution[k]).sum::<c64>() * (1.0 / of.len() as f64)
        };
        let means: Vec<Vec<c64>> = (0..orders).map(|k| all.iter().map(|of| mean(of, k)).collect()).collect();
        let rows: Vec<ChannelAtIndex> = measured.iter().map(|row| row.key).collect();
        let own: Vec<HarmonicScatter> = (0..orders).map(|k| harmonic_scatter(&rows, &all, &means[k], k)).collect();
        Ok(Self {
            scatters: (0..orders).map(|k| pooled_scatter(&own, k)).collect(),
            revolution_counts: measured.iter().map(|row| row.revolutions.len()).collect(),
            harmonic_means: means,
            rows,
        })
    }

    /// Data of independent channels with the declared standard uncertainty `u_mm` of one sample, `samples` per
    /// revolution, one revolution per row: u(c) = u·√(2/T).
    pub fn from_declared_uncertainty(
        rows: Vec<ChannelAtIndex>,
        means: Vec<Vec<c64>>,
        u_mm: f64,
        samples: usize,
    ) -> Self {
        let channels = rows.iter().map(|row| row.channel + 1).max().unwrap_or(0);
        let variance = u_mm * u_mm * 2.0 / samples as f64;
        let covariance = Mat::from_fn(channels, channels, |i, j| if i == j { variance } else { 0.0 });
        let scatter = HarmonicScatter { covariance, dof: f64::INFINITY };
        let scatters = vec![scatter; means.len()];
        Self { revolution_counts: vec![1; rows.len()], rows, harmonic_means: means, scatters }
    }

    /// The data of the rows for which `is_selected` is true.
    pub fn filter_rows(&self, is_selected: impl Fn(&ChannelAtIndex) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.rows.len()).filter(|i| is_selected(&self.rows[*i])).collect();
        Self {
            rows: kept.iter().map(|i| self.rows[*i]).collect(),
            revolution_counts: kept.iter().map(|i| self.revolution_counts[*i]).collect(),
            harmonic_means: self.harmonic_means.iter().map(|m| kept.iter().map(|i| m[*i]).collect()).collect(),
            scatters: self.scatters.clone(),
        }
    }

    /// Order of the highest harmonic.
    pub fn max_order(&self) -> usize {
        self.harmonic_means.len()
    }

    /// Observations of one harmonic: cosine parts of all rows, then sine parts of all rows.
    pub fn observations(&self, order: usize) -> Vec<f64> {
        let means = &self.harmonic_means[order - 1];
        means.iter().map(|m| m.re).chain(means.iter().map(|m| -m.im)).collect()
    }

    /// Observations of all harmonics of one revolution per row (`revolutions`: rows × angles).
    pub fn revolution_observations(&self, revolutions: &[Vec<f64>]) -> Vec<f64> {
        let basis = HarmonicBasis::new(revolutions.first().map_or(0, Vec::len), self.max_order());
        let all: Vec<Vec<c64>> = revolutions.iter().map(|of| basis.harmonics(of)).collect();
        let parts = |k: usize| {
            let of = |part: fn(&c64) -> f64| all.iter().map(move |row| part(&row[k]));
            of(|m| m.re).chain(of(|m| -m.im)).collect::<Vec<f64>>()
        };
        (0..self.max_order()).flat_map(parts).collect()
    }

    /// Standard uncertainty of each observation of the harmonic, mm.
    pub fn sigma_mm(&self, order: usize) -> Vec<f64> {
        let covariance = &self.scatters[order - 1].covariance;
        let sigma = |(row, revolutions): (&ChannelAtIndex, &usize)| {
            let variance = covariance[(row.channel, row.channel)] / *revolutions as f64;
            variance.sqrt().max(MIN_SIGMA_MM)
        };
        let half: Vec<f64> = self.rows.iter().zip(&self.revolution_counts).map(sigma).collect();
        half.repeat(2)
    }

    /// Covariance of the observations of the harmonic, mm². Channels of one index are correlated by the
    /// asynchronous part of the error motion.
    pub fn covariance(&self, order: usize) -> Mat<f64> {
        let (rows, scatter) = (self.rows.len(), &self.scatters[order - 1].covariance);
        Mat::from_fn(2 * rows, 2 * rows, |i, j| {
            let [a, b] = [self.rows[i % rows], self.rows[j % rows]];
            let revolutions = self.revolution_counts[i % rows] * self.revolution_counts[j % rows];
            let is_together = a.index == b.index && i / rows == j / rows;
            let factor = if is_together { 1.0 / (revolutions as f64).sqrt() } else { 0.0 };
            factor * scatter[(a.channel, b.channel)]
        })
    }
}

/// Scatter of one harmonic, pooled over the indexes. Each difference has two real parts.
fn harmonic_scatter(rows: &[ChannelAtIndex], all: &[Vec<Vec<c64>>], means: &[c64], k: usize) -> HarmonicScatter {
    let channels = rows.iter().map(|row| row.channel + 1).max().unwrap_or(0);
    let mut sums: Mat<f64> = Mat::zeros(channels, channels);
    let mut dofs: Mat<f64> = Mat::zeros(channels, channels);
    for (a, row_a) in rows.iter().enumerate() {
        for (b, row_b) in rows.iter().enumerate().filter(|(_, row)| row.index == row_a.index) {
            let pairs = all[a].iter().zip(&all[b]);
            let products = pairs.map(|(m, n)| ((m[k] - means[a]) * (n[k] - means[b]).conj()).re);
            sums[(row_a.channel, row_b.channel)] += products.sum::<f64>();
            dofs[(row_a.channel, row_b.channel)] += 2.0 * (all[a].len() as f64 - 1.0);
        }
    }
    let entry = |i, j| if dofs[(i, j)] > 0.0 { sums[(i, j)] / dofs[(i, j)] } else { 0.0 };
    let used = (0..channels).map(|i| dofs[(i, i)]).filter(|dof| *dof > 0.0);
    let dof = used.fold(f64::INFINITY, f64::min);
    HarmonicScatter { covariance: Mat::from_fn(channels, channels, entry), dof }
}

/// Mean over the harmonics `k` − w..=`k` + w, with the smallest w that reaches [`MIN_POOLED_DOF`].
fn pooled_scatter(own: &[HarmonicScatter], k: usize) -> HarmonicScatter {
    let window = |width: usize| &own[k.saturating_sub(width)..(k + width + 1).min(own.len())];
    let dof = |width: usize| window(width).iter().map(|scatter| scatter.dof).sum::<f64>();
    let width = (0..own.len()).find(|width| dof(*width) >= MIN_POOLED_DOF).unwrap_or(own.len());
    let channels = own[k].covariance.nrows();
    let mut covariance = Mat::zeros(channels, channels);
    for scatter in window(width) {
        covariance += &scatter.covariance * faer::Scale(1.0 / window(width).len() as f64);
    }
    HarmonicScatter { covariance, dof: dof(width) }
}

/// Revolutions from which no harmonics can be calculated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RevolutionsError {
    #[error("the scatter cannot be computed from one revolution")]
    SingleRevolution,
    #[error(
        "the revolutions have different numbers of samples, or {samples} samples are too few for {orders} harmonics"
    )]
    UnequalSamples { samples: usize, orders: usize },
    #[error(
        "channel {} at index {} has two sets of revolutions, or a different number of revolutions than the other channels",
        .0.channel, .0.index
    )]
    InconsistentRow(ChannelAtIndex),
}

impl RevolutionsError {
    /// Corrective action for the operator.
    pub fn remedy(&self) -> String {
        match self {
            Self::SingleRevolution => "measure at least two revolutions at an index".to_owned(),
            Self::UnequalSamples { orders, .. } => {
                format!("resample all revolutions to more than {} angles", 2 * orders)
            }
            Self::InconsistentRow(_) => {
                "pass each channel once for each index, with the revolutions common to all channels".to_owned()
            }
        }
    }
}

fn check_revolutions(measured: &[ChannelRevolutions], orders: usize) -> Result<(), RevolutionsError> {
    let counts = || measured.iter().map(|row| row.revolutions.len());
    if counts().all(|count| count < 2) || counts().any(|count| count == 0) {
        return Err(RevolutionsError::SingleRevolution);
    }
    let lengths = || measured.iter().flat_map(|row| &row.revolutions).map(Vec::len);
    let samples = lengths().next().unwrap_or(0);
    if lengths().any(|length| length != samples) || samples <= 2 * orders {
        return Err(RevolutionsError::UnequalSamples { samples, orders });
    }
    let differs = |a: &ChannelRevolutions, b: &ChannelRevolutions| {
        a.key == b.key && !std::ptr::eq(a, b)
            || a.key.index == b.key.index && a.revolutions.len() != b.revolutions.len()
    };
    let found = measured.iter().find(|a| measured.iter().any(|b| differs(a, b)));
    found.map_or(Ok(()), |row| Err(RevolutionsError::InconsistentRow(row.key)))
}
