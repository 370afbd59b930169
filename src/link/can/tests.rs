use super::*;
use crate::clock::HostClock;

#[test]
fn identifier_range_is_checked_and_format_is_that_of_can_utils() {
    assert_eq!(CanId::new(0x7FF, false).unwrap().to_string(), "7FF");
    assert_eq!(CanId::new(0x12, false).unwrap().to_string(), "012");
    assert_eq!(CanId::new(0x12, true).unwrap().to_string(), "00000012");
    assert_eq!(CanId::new(0x1FFF_FFFF, true).unwrap().to_string(), "1FFFFFFF");
    assert!(CanId::new(0x800, false).unwrap_err().contains("extended = true"));
    assert!(CanId::new(0x2000_0000, true).unwrap_err().contains("too large"));
}

#[test]
fn a_frame_keeps_eight_bytes_at_most() {
    let id = CanId::new(1, false).unwrap();
    assert!(CanFrame::new(0.0, id, &[]).data().is_empty());
    assert_eq!(CanFrame::new(0.0, id, &[1, 2, 3]).data(), [1, 2, 3]);
    assert_eq!(CanFrame::new(0.0, id, &[9; 12]).data(), [9; 8]);
}

/// With or without CAN in the kernel, a missing interface is refused with a fitting message.
#[test]
fn missing_interface_is_refused_with_a_remedy() {
    let id = CanId::new(1, false).unwrap();
    let error = CanReceiver::open("can-none", id, Arc::new(HostClock::start())).err().unwrap();
    match &error {
        CanError::NoKernelSupport { .. } => {
            assert!(error.remedy().contains("modprobe can can_raw"))
        }
        CanError::NoSuchInterface { interface, .. } => {
            assert_eq!(interface, "can-none");
            assert!(error.remedy().contains("ip -brief link show type can"));
        }
        other => panic!("{other}"),
    }
}

#[tokio::test]
async fn generated_frames_are_created_on_request() {
    let id = CanId::new(1, false).unwrap();
    let mut left = 2_u8;
    let mut can = CanReceiver::from_generator("memory", move || {
        left = left.checked_sub(1)?;
        Some(CanFrame::new(f64::from(left), id, &[left]))
    });
    assert!(can.generates_frames_on_demand());
    assert_eq!(can.try_next_event().unwrap(), None);
    let wait = Duration::from_secs(1);
    let frame = |t_s, byte| Some(CanEvent::Frame(CanFrame::new(t_s, id, &[byte])));
    assert_eq!(can.next_event(wait).await.unwrap(), frame(1.0, 1));
    assert_eq!(can.next_event(wait).await.unwrap(), frame(0.0, 0));
    assert_eq!(can.next_event(wait).await.unwrap(), None);
}
