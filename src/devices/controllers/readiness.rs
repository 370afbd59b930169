//! Items that must be known of a control before its first motion: one list for all controls.

use std::fmt;

/// An item of the list. A driver reads it and refuses a state that prevents a measurement, or reports the
/// item as not readable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReadinessItem {
    Units,
    Homing,
    TravelLimits,
    FeedOverride,
    RapidOverride,
    Offsets,
    ToolLength,
    Modes,
    Spindle,
    Kinematics,
    OtherClients,
    ProbeInput,
    Tool,
}

impl ReadinessItem {
    pub const ALL: [Self; 13] = [
        Self::Units,
        Self::Homing,
        Self::TravelLimits,
        Self::FeedOverride,
        Self::RapidOverride,
        Self::Offsets,
        Self::ToolLength,
        Self::Modes,
        Self::Spindle,
        Self::Kinematics,
        Self::OtherClients,
        Self::ProbeInput,
        Self::Tool,
    ];
}

impl fmt::Display for ReadinessItem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Units => "units of the positions",
            Self::Homing => "homed axes",
            Self::TravelLimits => "travel limits",
            Self::FeedOverride => "feed override",
            Self::RapidOverride => "rapid override",
            Self::Offsets => "active offsets",
            Self::ToolLength => "tool length offset",
            Self::Modes => "plane and distance mode",
            Self::Spindle => "spindle stopped",
            Self::Kinematics => "kinematics mode",
            Self::OtherClients => "other clients that send commands",
            Self::ProbeInput => "probe input",
            Self::Tool => "tool in the spindle",
        })
    }
}

/// Describes the items that are not readable; `None` if there are none.
pub fn describe_unreadable_items(items: &[ReadinessItem]) -> Option<String> {
    let names: Vec<String> = items.iter().map(ToString::to_string).collect();
    (!names.is_empty()).then(|| format!("not readable on this control: {}", names.join(", ")))
}
