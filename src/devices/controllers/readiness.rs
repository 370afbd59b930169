//! Items that must be known of a control before its first motion: one list for all controls.

/// Item that must be known before the first motion. A driver reads it and refuses a state that prevents a
/// measurement, or reports the item as not readable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReadinessItem {
    Units,
    /// Whether the axes are homed.
    Homing,
    TravelLimits,
    FeedOverride,
    RapidOverride,
    /// Offsets that shift the coordinates, such as G92 or a work offset.
    ActiveOffsets,
    /// Whether a tool length offset is active.
    ToolLength,
    PlaneAndDistanceMode,
    SpindleStopped,
    /// Whether the kinematics are in identity mode.
    Kinematics,
    /// Whether other clients of the control can send commands.
    OtherClients,
    ProbeInput,
    ToolInSpindle,
}

/// All items with their descriptions.
pub const READINESS_ITEMS: [(ReadinessItem, &str); 13] = [
    (ReadinessItem::Units, "units of the positions"),
    (ReadinessItem::Homing, "homed axes"),
    (ReadinessItem::TravelLimits, "travel limits"),
    (ReadinessItem::FeedOverride, "feed override"),
    (ReadinessItem::RapidOverride, "rapid override"),
    (ReadinessItem::ActiveOffsets, "active offsets"),
    (ReadinessItem::ToolLength, "tool length offset"),
    (ReadinessItem::PlaneAndDistanceMode, "plane and distance mode"),
    (ReadinessItem::SpindleStopped, "spindle stopped"),
    (ReadinessItem::Kinematics, "kinematics mode"),
    (ReadinessItem::OtherClients, "other clients that send commands"),
    (ReadinessItem::ProbeInput, "probe input"),
    (ReadinessItem::ToolInSpindle, "tool in the spindle"),
];

/// Describes the items that are not readable; `None` if there are none.
pub fn describe_unreadable_items(items: &[ReadinessItem]) -> Option<String> {
    let descriptions = items.iter().flat_map(|item| READINESS_ITEMS.iter().find(|(known, _)| known == item));
    let names: Vec<&str> = descriptions.map(|(_, description)| *description).collect();
    (!names.is_empty()).then(|| format!("not readable on this control: {}", names.join(", ")))
}
