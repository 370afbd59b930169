pub struct Circle {
    pub centre: [f64; 2],
    pub radius: f64,
}
#[derive(Debug, thiserror::Error)]
#[error("no circle")]
pub struct NoCircle;
pub fn fit(p: &[[f64; 2]]) -> Result<Circle, NoCircle> {
    let n = p.len() as f64;
    let (mx, my) =
        (p.iter().map(|q| q[0]).sum::<f64>() / n, p.iter().map(|q| q[1]).sum::<f64>() / n);
    let (mut suu, mut suv, mut svv, mut suz, mut svz) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for q in p {
        let (u, v) = (q[0] - mx, q[1] - my);
        let z = u * u + v * v;
        suu += u * u;
        suv += u * v;
        svv += v * v;
        suz += u * z;
        svz += v * z;
    }
    let det = suu * svv - suv * suv;
    if det.abs() < 1e-30 {
        return Err(NoCircle);
    }
    let (mut a, mut b) = ((svv * suz - suv * svz) / det / 2.0, (suu * svz - suv * suz) / det / 2.0);
    let mut r = (a * a + b * b + (suu + svv) / n).sqrt();
    for _ in 0..100 {
        let (mut h, mut g) = ([[0.0f64; 3]; 3], [0.0f64; 3]);
        for q in p {
            let (dx, dy) = (q[0] - mx - a, q[1] - my - b);
            let d = dx.hypot(dy).max(1e-300);
            let j = [-dx / d, -dy / d, -1.0];
            let f = d - r;
            for i in 0..3 {
                g[i] -= j[i] * f;
                for k in 0..3 {
                    h[i][k] += j[i] * j[k];
                }
            }
        }
        let m = glam::DMat3::from_cols_array_2d(&h);
        if m.determinant().abs() < 1e-12 {
            return Err(NoCircle);
        }
        let s = m.inverse() * glam::DVec3::from_array(g);
        a += s.x;
        b += s.y;
        r += s.z;
        if s.length() < 1e-13 {
            break;
        }
    }
    Ok(Circle { centre: [a + mx, b + my], radius: r })
}
