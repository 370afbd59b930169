//! Harmonics of the measured revolutions: their means, and their scatter between revolutions.

use std::f64::consts::TAU;

use faer::{Mat, c64};

use super::shared_revolutions::{ChannelAtMounting, ChannelRevolutions};

/// Degrees of freedom up to which the scatter of a harmonic is pooled with that of its neighbours. With this number
/// the expanded uncertainty is within 5 % of that of a known scatter.
const POOLING_TARGET_DOF: f64 = 30.0;
/// Minimum standard uncertainty of a harmonic, mm; replaces smaller values. It is below the resolution of any sensor
/// and above rounding errors.
const HARMONIC_STD_U_FLOOR_MM: f64 = 1e-9;

/// Covariance between channels, mm², of the cosine or sine part of one harmonic in one revolution.
#[derive(Debug, Clone)]
pub struct HarmonicScatter {
    /// Channels × channels; 0 for channels that were never measured together in two revolutions.
    pub channel_covariance: Mat<f64>,
    /// Degrees of freedom: the smallest of the channels, summed over the pooled harmonics; infinite if the scatter is
    /// declared.
    pub dof: f64,
}

/// Harmonics of all rows with their scatter: the input of the estimation.
#[derive(Debug, Clone)]
pub struct HarmonicData {
    /// Channel and mounting of each row.
    pub row_keys: Vec<ChannelAtMounting>,
    /// Number of revolutions in the mean of each row.
    pub revolution_counts: Vec<usize>,
    /// Mean of M_k over the revolutions, mm: harmonics (from order 1) × rows. M_k = c − i·s of c·cos kq + s·sin kq.
    pub harmonic_means: Vec<Vec<c64>>,
    /// Scatter of each harmonic, from order 1, of a single revolution; pooled with neighbouring harmonics if
    /// measured.
    pub harmonic_scatters: Vec<HarmonicScatter>,
}

/// Matrix e^(−ikq)·2/T (samples × harmonics) that gives the harmonics M_k, k = 1..=`max_order`, of one revolution of T
/// samples at equal angles q from 0.
pub struct HarmonicBasis(Mat<c64>);

impl HarmonicBasis {
    pub fn new(samples_per_revolution: usize, max_order: usize) -> Self {
        let factor = 2.0 / samples_per_revolution as f64;
        let phase = |i: usize, order: usize| {
            -TAU * ((i * order) % samples_per_revolution) as f64 / samples_per_revolution as f64
        };
        Self(Mat::from_fn(samples_per_revolution, max_order, |i, j| c64::cis(phase(i, j + 1)) * factor))
    }

    /// Harmonics of one revolution, from order 1.
    pub fn harmonics(&self, samples: &[f64]) -> Vec<c64> {
        let Self(basis) = self;
        let column = |j: usize| basis.col_as_slice(j).iter().zip(samples);
        (0..basis.ncols()).map(|j| column(j).map(|(b, sample)| b * sample).sum()).collect()
    }
}

impl HarmonicData {
    /// Computes the harmonics 1..=`max_order` of the revolutions, and the scatter from the differences between
    /// revolutions.
    ///
    /// # Errors
    /// Fewer than two revolutions at every mounting; rows that are inconsistent with each other; fewer than
    /// 2·`max_order` + 1 samples per revolution.
    pub fn from_revolutions(measured: &[ChannelRevolutions], max_order: usize) -> Result<Self, RevolutionsError> {
        check_revolution_and_sample_counts(measured, max_order)?;
        let samples = measured[0].revolutions[0].len();
        let basis = HarmonicBasis::new(samples, max_order);
        let harmonics = |row: &ChannelRevolutions| -> Vec<Vec<c64>> {
            row.revolutions.iter().map(|samples| basis.harmonics(samples)).collect()
        };
        let all: Vec<Vec<Vec<c64>>> = measured.iter().map(harmonics).collect();
        let mean = |of: &Vec<Vec<c64>>, k: usize| {
            of.iter().map(|revolution| revolution[k]).sum::<c64>() * (1.0 / of.len() as f64)
        };
        let means: Vec<Vec<c64>> = (0..max_order).map(|k| all.iter().map(|of| mean(of, k)).collect()).collect();
        let rows: Vec<ChannelAtMounting> = measured.iter().map(|row| row.key).collect();
        let own: Vec<HarmonicScatter> = (0..max_order).map(|k| harmonic_scatter(&rows, &all, &means[k], k)).collect();
        Ok(Self {
            harmonic_scatters: (0..max_order).map(|k| pooled_scatter(&own, k)).collect(),
            revolution_counts: measured.iter().map(|row| row.revolutions.len()).collect(),
            harmonic_means: means,
            row_keys: rows,
        })
    }

    /// Data of independent channels with the declared standard uncertainty u = `sample_std_u_mm` of one sample, T =
    /// `samples_per_revolution`, and one revolution per row: u(c) = u·√(2/T).
    pub fn from_declared_uncertainty(
        rows: Vec<ChannelAtMounting>,
        means: Vec<Vec<c64>>,
        sample_std_u_mm: f64,
        samples_per_revolution: usize,
    ) -> Self {
        let channels = rows.iter().map(|row| row.channel_index + 1).max().unwrap_or(0);
        let variance = sample_std_u_mm * sample_std_u_mm * 2.0 / samples_per_revolution as f64;
        let covariance = Mat::from_fn(channels, channels, |i, j| if i == j { variance } else { 0.0 });
        let scatter = HarmonicScatter { channel_covariance: covariance, dof: f64::INFINITY };
        let scatters = vec![scatter; means.len()];
        Self {
            revolution_counts: vec![1; rows.len()],
            row_keys: rows,
            harmonic_means: means,
            harmonic_scatters: scatters,
        }
    }

    /// The data of the rows for which `is_selected` is true. The scatter is not changed.
    pub fn filter_rows(&self, is_selected: impl Fn(&ChannelAtMounting) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.row_keys.len()).filter(|i| is_selected(&self.row_keys[*i])).collect();
        Self {
            row_keys: kept.iter().map(|i| self.row_keys[*i]).collect(),
            revolution_counts: kept.iter().map(|i| self.revolution_counts[*i]).collect(),
            harmonic_means: self.harmonic_means.iter().map(|m| kept.iter().map(|i| m[*i]).collect()).collect(),
            harmonic_scatters: self.harmonic_scatters.clone(),
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

    /// Observations of one revolution per row (`revolutions`: rows × angles), harmonic after harmonic, each in the
    /// order of [`observations`](Self::observations).
    pub fn revolution_observations(&self, revolutions: &[Vec<f64>]) -> Vec<f64> {
        let basis = HarmonicBasis::new(revolutions.first().map_or(0, Vec::len), self.max_order());
        let all: Vec<Vec<c64>> = revolutions.iter().map(|of| basis.harmonics(of)).collect();
        let parts = |k: usize| {
            let of = |part: fn(&c64) -> f64| all.iter().map(move |row| part(&row[k]));
            of(|m| m.re).chain(of(|m| -m.im)).collect::<Vec<f64>>()
        };
        (0..self.max_order()).flat_map(parts).collect()
    }

    /// Standard uncertainty of each observation of the harmonic, which is a mean over the revolutions of its row, mm;
    /// at least 1e-9 mm.
    pub fn observation_std_u_mm(&self, order: usize) -> Vec<f64> {
        let covariance = &self.harmonic_scatters[order - 1].channel_covariance;
        let sigma = |(row, revolutions): (&ChannelAtMounting, &usize)| {
            let variance = covariance[(row.channel_index, row.channel_index)] / *revolutions as f64;
            variance.sqrt().max(HARMONIC_STD_U_FLOOR_MM)
        };
        let half: Vec<f64> = self.row_keys.iter().zip(&self.revolution_counts).map(sigma).collect();
        half.repeat(2)
    }

    /// Covariance of the observations of the harmonic (means over the revolutions of a row), mm². Channels at one
    /// mounting are correlated by the asynchronous part of the error motion; cosine and sine parts are not.
    pub fn observation_covariance(&self, order: usize) -> Mat<f64> {
        let (rows, scatter) = (self.row_keys.len(), &self.harmonic_scatters[order - 1].channel_covariance);
        Mat::from_fn(2 * rows, 2 * rows, |i, j| {
            let [a, b] = [self.row_keys[i % rows], self.row_keys[j % rows]];
            let revolutions = self.revolution_counts[i % rows] * self.revolution_counts[j % rows];
            let is_together = a.mounting_index == b.mounting_index && i / rows == j / rows;
            let factor = if is_together { 1.0 / (revolutions as f64).sqrt() } else { 0.0 };
            factor * scatter[(a.channel_index, b.channel_index)]
        })
    }
}

/// Scatter of one harmonic, pooled over the mountings. The real and the imaginary part of a deviation count as two
/// observations. `revolution_harmonics`: rows × revolutions × harmonics.
fn harmonic_scatter(
    rows: &[ChannelAtMounting],
    revolution_harmonics: &[Vec<Vec<c64>>],
    means: &[c64],
    harmonic_index: usize,
) -> HarmonicScatter {
    let channels = rows.iter().map(|row| row.channel_index + 1).max().unwrap_or(0);
    let mut sums: Mat<f64> = Mat::zeros(channels, channels);
    let mut dofs: Mat<f64> = Mat::zeros(channels, channels);
    for (a, row_a) in rows.iter().enumerate() {
        for (b, row_b) in rows.iter().enumerate().filter(|(_, row)| row.mounting_index == row_a.mounting_index) {
            let pairs = revolution_harmonics[a].iter().zip(&revolution_harmonics[b]);
            let products =
                pairs.map(|(m, n)| ((m[harmonic_index] - means[a]) * (n[harmonic_index] - means[b]).conj()).re);
            sums[(row_a.channel_index, row_b.channel_index)] += products.sum::<f64>();
            dofs[(row_a.channel_index, row_b.channel_index)] += 2.0 * (revolution_harmonics[a].len() as f64 - 1.0);
        }
    }
    let entry = |i, j| if dofs[(i, j)] > 0.0 { sums[(i, j)] / dofs[(i, j)] } else { 0.0 };
    let used = (0..channels).map(|i| dofs[(i, i)]).filter(|dof| *dof > 0.0);
    let dof = used.fold(f64::INFINITY, f64::min);
    HarmonicScatter { channel_covariance: Mat::from_fn(channels, channels, entry), dof }
}

/// Mean over the harmonics `harmonic_index` − w..=`harmonic_index` + w, with the smallest w whose degrees of freedom
/// together reach [`POOLING_TARGET_DOF`], or over all harmonics.
fn pooled_scatter(unpooled: &[HarmonicScatter], harmonic_index: usize) -> HarmonicScatter {
    let window = |width: usize| {
        &unpooled[harmonic_index.saturating_sub(width)..(harmonic_index + width + 1).min(unpooled.len())]
    };
    let dof = |width: usize| window(width).iter().map(|scatter| scatter.dof).sum::<f64>();
    let width = (0..unpooled.len()).find(|width| dof(*width) >= POOLING_TARGET_DOF).unwrap_or(unpooled.len());
    let channels = unpooled[harmonic_index].channel_covariance.nrows();
    let mut covariance = Mat::zeros(channels, channels);
    for scatter in window(width) {
        covariance += &scatter.channel_covariance * faer::Scale(1.0 / window(width).len() as f64);
    }
    HarmonicScatter { channel_covariance: covariance, dof: dof(width) }
}

/// Revolutions from which no harmonics can be calculated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RevolutionsError {
    /// Every mounting has fewer than two revolutions, or one has none.
    #[error("the scatter cannot be computed from one revolution")]
    SingleRevolution,
    #[error(
        "the revolutions have different numbers of samples, or {samples} samples are too few for {orders} harmonics"
    )]
    /// `samples`: number in the first revolution. `orders`: number of requested harmonics.
    UnusableSampleCount { samples: usize, orders: usize },
    #[error(
        "channel {} at index {} has two sets of revolutions, or a different number of revolutions than the other channels",
        .0.channel_index, .0.mounting_index
    )]
    /// The channel occurs twice at this mounting, or has another number of revolutions than a channel there.
    InconsistentChannelRevolutions(ChannelAtMounting),
}

impl RevolutionsError {
    /// Corrective action for the operator.
    pub fn remedy(&self) -> String {
        match self {
            Self::SingleRevolution => "measure at least two revolutions at an index".to_owned(),
            RevolutionsError::UnusableSampleCount { orders, .. } => {
                format!("resample all revolutions to more than {} angles", 2 * orders)
            }
            RevolutionsError::InconsistentChannelRevolutions(_) => {
                "pass each channel once for each index, with the revolutions common to all channels".to_owned()
            }
        }
    }
}

fn check_revolution_and_sample_counts(
    measured: &[ChannelRevolutions],
    max_order: usize,
) -> Result<(), RevolutionsError> {
    let counts = || measured.iter().map(|row| row.revolutions.len());
    if counts().all(|count| count < 2) || counts().any(|count| count == 0) {
        return Err(RevolutionsError::SingleRevolution);
    }
    let lengths = || measured.iter().flat_map(|row| &row.revolutions).map(Vec::len);
    let samples = lengths().next().unwrap_or(0);
    if lengths().any(|length| length != samples) || samples <= 2 * max_order {
        return Err(RevolutionsError::UnusableSampleCount { samples, orders: max_order });
    }
    let differs = |a: &ChannelRevolutions, b: &ChannelRevolutions| {
        a.key == b.key && !std::ptr::eq(a, b)
            || a.key.mounting_index == b.key.mounting_index && a.revolutions.len() != b.revolutions.len()
    };
    let found = measured.iter().find(|a| measured.iter().any(|b| differs(a, b)));
    found.map_or(Ok(()), |row| Err(RevolutionsError::InconsistentChannelRevolutions(row.key)))
}
