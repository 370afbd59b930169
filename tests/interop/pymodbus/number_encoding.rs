//! Compares our encoding of numbers in registers with that of pymodbus.

use std::collections::BTreeMap;
use std::process::Command;

use libtest_mimic::Failed;
use link::modbus::number_format::{ByteOrder, NumberFormat, NumberType};

use super::pymodbus::python_with_pymodbus;
use super::server::peer_script_path;

type WordsByTypeAndOrder = BTreeMap<String, BTreeMap<String, Vec<(f64, Vec<u16>)>>>;

pub fn number_types_agree_with_pymodbus() -> Result<(), Failed> {
    let output = Command::new(python_with_pymodbus().ok_or("no python")?).arg(peer_script_path("words.py")).output()?;
    let all: WordsByTypeAndOrder = serde_json::from_slice(&output.stdout)?;
    let mut count = 0;
    for (kind, orders) in &all {
        for (order, values) in orders {
            let number_type: NumberType = serde_json::from_value(kind.as_str().into())?;
            let byte_order: ByteOrder = serde_json::from_value(order.as_str().into())?;
            let number = NumberFormat { number_type, order: byte_order, scale: 1.0 };
            for (value, words) in values {
                let place = format!("{kind} {order} {value}");
                assert_eq!(number.decode(words)?, *value, "{place}");
                assert_eq!(number.encode(*value)?, *words, "{place}");
                count += 1;
            }
        }
    }
    assert_eq!((all.len(), count), (8, 4 * (3 * 6 + 3 * 9 + 2 * 5)));
    Ok(())
}
