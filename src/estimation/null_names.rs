pub fn in_words(n: faer::MatRef<'_, f64>, names: &[String]) -> Vec<String> {
    (0..n.ncols())
        .map(|j| {
            (0..n.nrows())
                .filter(|i| n[(*i, j)].abs() > 1e-6)
                .map(|i| names[i].clone())
                .collect::<Vec<_>>()
                .join(" + ")
        })
        .collect()
}
