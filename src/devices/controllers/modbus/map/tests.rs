use super::*;

fn parse_map(toml: &str) -> Result<WindowRegisterMap, String> {
    toml::from_str::<WindowRegisterMap>(toml).map_err(|error| error.message().to_owned())
}

#[test]
fn published_window_is_valid_and_limits_the_access() {
    let published = parse_map("").unwrap();
    let allowed = published.access_ranges();
    assert_eq!(allowed.readable, [RegisterRange { space: RegisterSpace::Input, first: 0, last: 44 }]);
    assert_eq!(allowed.writable, [RegisterRange { space: RegisterSpace::Holding, first: 0, last: 105 }]);
    assert_eq!(published.status.block_first_and_count(), (0, 45));
    assert_eq!(published.axis_without_registers(&[Axis::X, Axis::C]), None);
}

#[test]
fn item_can_have_another_address_and_type() {
    let moved = parse_map(
        "
        [command]
        hold = { address = 500 }
        [status]
        space = \"holding\"
        sequence_head = { address = 200 }
        sequence_tail = { address = 299 }
        version = { address = 201 }
        state = { address = 202 }
        alarm = { address = 203 }
        accepted = { address = 204 }
        executed = { address = 205 }
        error = { address = 206 }
        probe = { address = 207 }
        inputs = { address = 208, type = \"u16\" }
        latches = { address = 210 }
        heartbeat = { address = 211 }
        time_s = { address = 212, type = \"f32\", order = \"cdab\" }
        latch_time_s = { address = 216 }
        latch = { X = { address = 220, type = \"f32\", scale = 1.0 } }
        position = { X = { address = 230, scale = 0.0001 } }
    ",
    )
    .unwrap();
    assert_eq!(moved.status.block_first_and_count(), (200, 100));
    assert_eq!(moved.access_ranges().writable.len(), 2);
    assert_eq!(moved.axis_without_registers(&[Axis::X, Axis::C]), Some(Axis::C));
    let mut block = vec![0; 100];
    (block[30], block[31]) = (0xFFFF, 0xFFFE);
    assert_eq!(moved.status.position[&Axis::X].decode_from_block(&block, 200), Ok(-0.0002));
}

#[test]
fn invalid_map_is_refused_with_a_reason() {
    for (text, why) in [
        ("[command]\nhold = { address = 1 }", "overlap at address"),
        ("[command]\nchunk = { registers = 124 }", "one request writes"),
        ("[command]\nchunk = { registers = 120 }", "must be adjacent"),
        ("[command]\ncrc = { address = 200 }", "must be adjacent"),
        ("[command]\nlength = { address = 106 }\ncrc = { address = 5 }", "must be adjacent"),
        ("[status]\nsequence_tail = { address = 200 }", "one request reads"),
        ("[status]\nstate = { address = 60 }", "is outside the block"),
        ("[status]\nspace = \"coil\"", "single bits"),
        ("[status]\nlatch = { X = { type = \"f32\" } }", "needs an `address`"),
        ("[status]\ntime_s = { scale = 0.0 }", "greater than 0"),
        ("[status]\nspace = \"holding\"", "overlap at address"),
        ("[status]\nstat = { address = 1 }", "unknown field"),
        ("[status]\nstate = { adress = 1 }", "unknown field"),
    ] {
        let said = parse_map(text).unwrap_err();
        assert!(said.contains(why), "{text}: {said}");
    }
}

#[test]
fn text_has_two_characters_per_register() {
    let mut chunk = parse_map("").unwrap().command.chunk;
    assert_eq!(chunk.encode_text(b"G1X"), (6, vec![0x4731, 0x5800]));
    chunk.order = ByteOrder::Badc;
    assert_eq!(chunk.encode_text(b"G1X"), (6, vec![0x3147, 0x0058]));
}
