//! Seeded random streams: one independent ChaCha8 stream for each key. The algorithm is fixed, so that a seed gives
//! the same numbers in every release.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Random stream of `seed` for `key`, e.g. `[step, repeat number]`. The same arguments give the same stream;
/// different keys give independent streams.
pub fn seeded_stream(seed: u64, key: &[u64]) -> ChaCha8Rng {
    let mixed =
        key.iter().fold(split_mix_64(seed), |state, part| split_mix_64(state ^ split_mix_64(*part ^ 0x5851_F42D)));
    ChaCha8Rng::seed_from_u64(mixed)
}

/// The finalizer of SplitMix64 (Steele, Lea, Flood 2014): every input bit reaches every output bit.
fn split_mix_64(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}
