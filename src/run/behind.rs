//! On a small computer the run comes first, then whoever asks for a hold, then what computes.

/// What computes for long: proofs, identifications.
pub const COMPUTING: i32 = 10;
/// Pages, and whoever reads them.
pub const ANSWERING: i32 = 5;

/// From now on this thread steps back behind the run's by so much (nice(2): of the thread alone on Linux).
/// Where that is not granted it goes on as before.
pub fn behind(the_run: i32) {
    let _ = rustix::process::nice(the_run);
}

#[cfg(test)]
mod tests {
    use rustix::process::getpriority_process;

    use super::*;

    #[test]
    fn the_others_stay_where_they_are() {
        let before = getpriority_process(None).unwrap();
        let stepped = std::thread::spawn(|| {
            behind(ANSWERING);
            getpriority_process(None).unwrap()
        });
        // No lower than the lowest.
        assert_eq!(stepped.join().unwrap(), (before + ANSWERING).min(19));
        assert_eq!(getpriority_process(None).unwrap(), before);
    }
}
