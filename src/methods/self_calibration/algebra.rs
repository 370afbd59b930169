//! Products of matrices and vectors in plain slices.

use faer::Mat;

pub fn dot(coefficients: &[f64], x: &[f64]) -> f64 {
    coefficients.iter().zip(x).map(|(c, v)| c * v).sum()
}

pub fn multiply(matrix: &Mat<f64>, vector: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; matrix.nrows()];
    for (j, value) in vector.iter().enumerate() {
        for (out, m) in product.iter_mut().zip(matrix.col_as_slice(j)) {
            *out += m * value;
        }
    }
    product
}
