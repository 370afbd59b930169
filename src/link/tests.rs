use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::Instant;

use super::*;

fn deadline_in_five_seconds() -> Instant {
    Instant::now() + Duration::from_secs(5)
}

fn line(text: &str) -> Option<LineEvent> {
    Some(LineEvent::Line(text.to_owned()))
}

#[tokio::test]
async fn lines_pass_in_both_directions_and_a_lost_link_is_reported() {
    let (ours, mut theirs) = tokio::io::duplex(64);
    let mut link = LineLink::from_stream("peer", ours);
    link.send_line("?").unwrap();
    let mut bytes = [0; 2];
    theirs.read_exact(&mut bytes).await.unwrap();
    assert_eq!(&bytes, b"?\n");
    theirs.write_all(b"ok\r\n").await.unwrap();
    assert_eq!(link.recv_deadline(deadline_in_five_seconds()).await.unwrap(), line("ok"));
    let passed = link.recv_deadline(Instant::now()).await.unwrap();
    assert_eq!(passed, None);
    drop(theirs);
    for _ in 0..2 {
        let error = link.recv_deadline(deadline_in_five_seconds()).await.unwrap_err();
        assert_eq!(error.to_string(), "the link to peer is lost: the device closed the connection");
    }
}

#[tokio::test]
async fn urgent_bytes_overtake_queued_messages_without_splitting_one() {
    let (ours, mut theirs) = tokio::io::duplex(4);
    let link = LineLink::from_stream("peer", ours);
    link.send(b"first line\n").unwrap();
    let mut start = [0; 1];
    theirs.read_exact(&mut start).await.unwrap();
    for _ in 0..100 {
        link.send(b"later\n").unwrap();
    }
    link.urgent_sender().send(b"!");
    let mut rest = [0; 16];
    theirs.read_exact(&mut rest).await.unwrap();
    assert_eq!(&rest, b"irst line\n!later");
}

#[tokio::test]
async fn after_a_hold_only_urgent_bytes_follow() {
    let (ours, mut theirs) = tokio::io::duplex(4);
    let link = LineLink::from_stream("peer", ours);
    link.send(b"first line\n").unwrap();
    let mut start = [0; 1];
    theirs.read_exact(&mut start).await.unwrap();
    link.send(b"queued\n").unwrap();
    link.urgent_sender().send_and_drop_non_urgent(b"!");
    link.send(b"too late\n").unwrap();
    link.urgent_sender().send(b"?");
    drop(link);
    let mut rest = Vec::new();
    theirs.read_to_end(&mut rest).await.unwrap();
    rest.sort();
    let mut expected = *b"irst line\n!?";
    expected.sort();
    assert_eq!(rest, expected);
}

#[tokio::test]
async fn a_hold_is_sent_although_the_handle_is_dropped() {
    let (ours, mut theirs) = tokio::io::duplex(64);
    let link = LineLink::from_stream("peer", ours);
    link.urgent_sender().send(b"!");
    drop(link);
    let mut bytes = Vec::new();
    theirs.read_to_end(&mut bytes).await.unwrap();
    assert_eq!(bytes, b"!");
}

#[tokio::test]
async fn a_pty_is_opened_by_one_client_at_a_time() {
    let mut pty = create_pty().unwrap();
    let address = LinkAddress::Serial { path: pty.path.clone(), baud: 115_200 };
    let mut link = open_line_link(&address).await.unwrap();
    assert!(matches!(open_line_link(&address).await, Err(LinkError::Busy { .. })));
    link.send_line("$I").unwrap();
    let mut bytes = [0; 3];
    pty.device.read_exact(&mut bytes).await.unwrap();
    assert_eq!(&bytes, b"$I\n");
    pty.device.write_all(b"[AXS:5:XYZBC]\r\nok\r\n").await.unwrap();
    assert_eq!(link.recv_deadline(deadline_in_five_seconds()).await.unwrap(), line("[AXS:5:XYZBC]"));
    assert_eq!(link.recv_deadline(deadline_in_five_seconds()).await.unwrap(), line("ok"));
}

#[tokio::test]
async fn missing_port_is_reported() {
    let path = "/dev/no-such-port".to_owned();
    let serial = open_line_link(&LinkAddress::Serial { path, baud: 115_200 }).await;
    assert!(matches!(serial, Err(LinkError::NoSuchPort { .. })));
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    drop(listener);
    let tcp = open_line_link(&LinkAddress::Tcp { host: "127.0.0.1".to_owned(), port }).await;
    let error = tcp.err().unwrap();
    assert_eq!(error.to_string(), format!("no server listens at 127.0.0.1:{port}"));
}

#[tokio::test]
async fn serial_port_is_found_by_its_stable_name() {
    let folder = tempfile::tempdir().unwrap();
    let found = |id: &str| find_serial_port_by_id(folder.path(), id);
    let none = found("board-1").unwrap_err();
    assert_eq!(none.to_string(), "no unique serial port matches `board-1`; available: none");
    let (before, mut after) = (create_pty().unwrap(), create_pty().unwrap());
    let name = "usb-Maker_board-1_A-if00";
    let link = folder.path().join(name);
    std::os::unix::fs::symlink(&before.path, &link).unwrap();
    std::os::unix::fs::symlink("/dev/null", folder.path().join("usb-Maker_board-2_B-if00")).unwrap();
    for id in [name, "board-1", "_A-"] {
        assert_eq!(found(id).unwrap(), link);
    }
    for id in ["Maker", "board-3", ""] {
        let message = found(id).unwrap_err().to_string();
        assert!(message.contains(name) && message.contains("board-2"), "{message}");
    }
    // The device is unplugged, and comes back at another path.
    std::fs::remove_file(&link).unwrap();
    assert!(found("board-1").is_err());
    std::os::unix::fs::symlink(&after.path, &link).unwrap();
    let path = found("board-1").unwrap().display().to_string();
    let link = open_line_link(&LinkAddress::Serial { path, baud: 115_200 }).await.unwrap();
    link.send(b"?").unwrap();
    assert_eq!(after.device.read_u8().await.unwrap(), b'?');
}
