//! Checks that a register map is valid: no overlaps, and blocks that one request can read or write.

use super::{ChunkRegisters, MAX_READ_REGISTERS, MAX_WRITE_REGISTERS, WindowRegisterMap};
use link::modbus::RegisterSpace;
use link::modbus::number_format::ByteOrder;

/// Maximum number of registers for the parameters of a resident program: far more than any touch needs.
const MAX_PARAMETER_REGISTERS: usize = 2000;

/// # Errors
/// The map is invalid; the message names the items.
pub(super) fn check_map(map: &WindowRegisterMap) -> Result<(), String> {
    if !matches!(map.status.space, RegisterSpace::Input | RegisterSpace::Holding) {
        return Err("`status.space` must be `input` or `holding`: coils and discrete inputs are single bits".to_owned());
    }
    let ChunkRegisters { register_count: registers, order, .. } = map.command.chunk;
    // A line must fit in one request; parameters are read back before they take effect, and may need
    // several requests.
    let is_program = map.status.result.is_some();
    let max_registers = if is_program { MAX_PARAMETER_REGISTERS } else { MAX_WRITE_REGISTERS };
    if !(1..=max_registers).contains(&usize::from(registers)) {
        return Err(format!(
            "`command.chunk` has {registers} registers; {} 1 to {max_registers}",
            if is_program { "a resident program accepts" } else { "one request writes" }
        ));
    }
    if is_program && order != ByteOrder::default() {
        return Err(
            "`command.chunk` of a resident program must have no `order`: set the `order` of each parameter".to_owned()
        );
    }
    if !is_program {
        check_one_request_writes_line(map)?;
    }
    check_scales_are_positive(map)?;
    check_one_request_reads_status(map)?;
    let command = map.command.register_names_addresses_and_counts().into_iter();
    let command = command.map(|(name, at, count)| (RegisterSpace::Holding, at, count, format!("command.{name}")));
    let status = map.status.register_names_addresses_and_counts().into_iter();
    let status = status.map(|(name, at, count)| (map.status.space, at, count, format!("status.{name}")));
    check_overlaps(command.chain(status).collect())
}

/// Checks that one request writes a line with its acknowledgement, checksum and length: then a late request for the
/// previous line cannot mix its values with those of the next line.
fn check_one_request_writes_line(map: &WindowRegisterMap) -> Result<(), String> {
    const LINE_REQUEST_ITEMS: [&str; 4] = ["acknowledge", "crc", "length", "chunk"];
    let mut spans = map.command.register_names_addresses_and_counts();
    spans.retain(|(name, ..)| LINE_REQUEST_ITEMS.contains(name));
    spans.sort_by_key(|(_, at, _)| *at);
    let is_adjacent = |pair: &[(&str, u16, u16)]| match pair {
        [(_, at, count), (_, next, _)] => u32::from(*at) + u32::from(*count) == u32::from(*next),
        _ => true,
    };
    let registers: usize = spans.iter().map(|(.., count)| usize::from(*count)).sum();
    let is_chunk_last = spans.last().is_some_and(|(name, ..)| *name == "chunk");
    // The heartbeat register may directly precede these items; the same request then writes it.
    if is_chunk_last && spans.windows(2).all(is_adjacent) && registers < MAX_WRITE_REGISTERS {
        return Ok(());
    }
    Err(format!(
        "`command.acknowledge`, `crc`, `length` and `chunk` must be adjacent, `chunk` last, at most {} \
         registers: one request writes them, so that no value of the previous line remains",
        MAX_WRITE_REGISTERS - 1
    ))
}

/// Checks that the scales of positions and times are greater than 0.
fn check_scales_are_positive(map: &WindowRegisterMap) -> Result<(), String> {
    let status = &map.status;
    let axes = status.latched_position.values().chain(status.position.values());
    let times = [status.control_time_s, status.latch_time_s];
    match axes.chain(&times).find(|register| register.number_format.scale <= 0.0) {
        None => Ok(()),
        Some(register) => Err(format!("the scale at address {} must be greater than 0", register.address)),
    }
}

/// Checks that one request can read the status, head first, tail last.
fn check_one_request_reads_status(map: &WindowRegisterMap) -> Result<(), String> {
    let (first, count) = map.status.block_first_and_count();
    let last = map.status.sequence_tail.address;
    for (name, address, length) in map.status.register_names_addresses_and_counts() {
        let end = usize::from(address) + usize::from(length);
        if address < first || name != "sequence_tail" && end > usize::from(last) {
            return Err(format!(
                "`status.{name}` at {address} is outside the block from `sequence_head` at {first} to \
                 `sequence_tail` at {last}"
            ));
        }
    }
    if usize::from(count) > MAX_READ_REGISTERS {
        return Err(format!("the status block has {count} registers; one request reads at most {MAX_READ_REGISTERS}"));
    }
    Ok(())
}

/// Space, first register, number of registers and name of an item.
pub(in super::super) type RegisterSpan = (RegisterSpace, u16, u16, String);

/// Checks that no two items overlap.
///
/// # Errors
/// Two items overlap, or an item begins at the last address (65535); the message names them.
pub(in super::super) fn check_overlaps(mut items: Vec<RegisterSpan>) -> Result<(), String> {
    items.sort();
    for pair in items.windows(2) {
        let [(space, at, count, name), (next_space, next, _, next_name)] = pair else { continue };
        if space == next_space && usize::from(*at) + usize::from(*count) > usize::from(*next) {
            return Err(format!("`{name}` and `{next_name}` overlap at address {next}"));
        }
        if usize::from(*next) + 1 > usize::from(u16::MAX) {
            return Err(format!("`{next_name}` is beyond the last address"));
        }
    }
    Ok(())
}
