//! True quantities of the scene, for tests alone.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::super::machine_pose::MachinePose;
use super::TrueScene;
use machine::kinematics::{ErrorShape, ErrorTerm};
use machine::{Axis, Position, frame::Point};

impl TrueScene {
    /// Synchronous error motion, stated and drawn, of a rotary axis along or about the axis `component`, mm or rad,
    /// without location errors.
    pub fn rotary_error_motion(&self, axis: Axis, component: Axis, angle: f64) -> f64 {
        let at = Position::new().with(axis, angle);
        let errors = self.error_terms_at(&at, None);
        let axis_errors =
            errors.iter().filter(|term| (term.parameter.axis(), term.parameter.component()) == (axis, component));
        // A drawn motion is a location error at this angle; a stated location error is not a motion.
        let stated =
            |term: &&ErrorTerm| term.parameter.shape() == ErrorShape::Location && self.true_error_terms.contains(term);
        axis_errors.filter(|term| !stated(term)).map(|term| term.value * term.parameter.shape_factor(angle)).sum()
    }

    /// The true stylus-ball centre, spindle frame, mm.
    pub fn true_stylus_centre_in_spindle(&self) -> Vector3<f64> {
        self.true_stylus_centre
    }

    /// Displacement of the table, machine frame, mm.
    pub fn table_drift(&self, t_s: f64) -> Vector3<f64> {
        self.drift.table_displacement_mm(t_s)
    }

    /// Position of the rotary axis in the two directions across it (C: X, Y; A: Y, Z; B: Z, X) at
    /// `distance_along_axis`: the commanded position of the stated stylus centre that does not move on the table in
    /// half a turn, with location errors, gains, drift and the errors of X, Y and Z at the stated axis. NaN for an
    /// axis that does not carry the part.
    pub fn rotary_axis_position_across(&self, axis: Axis, distance_along_axis: f64, t_s: f64) -> [f64; 2] {
        let mut lasting_errors: Vec<ErrorTerm> = self
            .true_error_terms
            .iter()
            .filter(|term| matches!(term.parameter.shape(), ErrorShape::Location | ErrorShape::Gain))
            .copied()
            .collect();
        let [u, v, w] = match axis {
            Axis::A => [Vector3::y(), Vector3::z(), Vector3::x()],
            Axis::B => [Vector3::z(), Vector3::x(), Vector3::y()],
            _ => [Vector3::x(), Vector3::y(), Vector3::z()],
        };
        let stated = self.chain.axis_line(axis, &Position::new());
        let across = stated.map_or(Vector3::zeros(), |line| line.point - w * line.point.dot(&w));
        let about = self.linear_axes_for_stylus(w * distance_along_axis + across);
        lasting_errors.extend(self.angular_errors.error_terms_at(&Position::from_xyz(about)));
        let shift = self.linear_errors.deviation_at(about.into()) - self.drift.table_displacement_mm(t_s);
        let moved = |at: Vector2<f64>| {
            let stylus = w * distance_along_axis + u * at.x + v * at.y;
            let turn = self.stylus_displacement_in_half_turn(axis, stylus, &lasting_errors, shift);
            Vector2::new(turn.dot(&u), turn.dot(&v))
        };
        // The motion is affine in the position: three values give the root exactly.
        let origin = moved(Vector2::zeros());
        let slope = Matrix2::from_columns(&[Vector2::x(), Vector2::y()].map(|at| moved(at) - origin));
        let inverse = slope.try_inverse().filter(|_| slope.determinant().abs() >= 1e-3);
        inverse.map_or([f64::NAN; 2], |inverse| (-(inverse * origin)).into())
    }

    /// X, Y and Z that bring the stated stylus centre to `stylus`, with the rotary axes at zero; NaN if the linear
    /// axes do not span space.
    fn linear_axes_for_stylus(&self, stylus: Vector3<f64>) -> Vector3<f64> {
        let (target, tool) = (Point::from_vec(stylus), Point::from_vec(self.stated_stylus_centre));
        let position = self.chain.solve_linear_axes(target, tool, &Position::new(), &[]);
        position.map_or(Vector3::repeat(f64::NAN), |position| position.xyz_or_zero())
    }

    /// Displacement relative to the table, over half a turn, of the stylus centre commanded to `stylus`. `shift`:
    /// displacement of the tool against the table.
    fn stylus_displacement_in_half_turn(
        &self,
        axis: Axis,
        stylus: Vector3<f64>,
        errors: &[ErrorTerm],
        shift: Vector3<f64>,
    ) -> Vector3<f64> {
        let position = Position::from_xyz(self.linear_axes_for_stylus(stylus));
        let stylus_on_table = |angle| {
            let at = position.clone().with(axis, angle);
            let table = self.chain.machine_from_table(&at, errors);
            let spindle = self.chain.machine_from_spindle(&at, errors);
            MachinePose { table_pose: table, carrier_pose: spindle, carrier_shift: shift }
                .carrier_to_table_point(self.stated_stylus_centre)
        };
        stylus_on_table(std::f64::consts::PI) - stylus_on_table(0.0)
    }
}
