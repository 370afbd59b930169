//! Times in reports and on the page.

use jiff::Timestamp;
use jiff::tz::TimeZone;

/// Date, time and zone of this computer: `2026-11-27 05:29:19 CET`.
pub fn format_local_time(at: Timestamp) -> String {
    at.to_zoned(TimeZone::system()).strftime("%Y-%m-%d %H:%M:%S %Z").to_string()
}
