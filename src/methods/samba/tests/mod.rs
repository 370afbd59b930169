use crate::kinematics::Topology;
use crate::record::machine::{AxisSpec, Machine};

/// A machine without travel limits to speak of.
pub fn machine(topology: &str) -> Machine {
    let parsed: Topology = topology.parse().unwrap();
    let spec: AxisSpec = serde_json::from_str(r#"{"min":-1000,"max":1000}"#).unwrap();
    Machine {
        name: "test".into(),
        topology: topology.into(),
        axes: parsed.axes().map(|axis| (axis, spec.clone())).collect(),
        tool_mm: [0.0, 0.0, -326.717],
        drift_um_per_h: 0.0,
    }
}
