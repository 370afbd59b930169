//! Migration of a journal of an older version.

use std::path::Path;

use jiff::Timestamp;
use rusqlite::{Connection, OpenFlags, TransactionBehavior};

use super::schema::{CURRENT_FORMAT, MIGRATIONS, format_version};
use super::{StoreFault, checksum, format_identification, verified_copy};

/// Migrates the tables in one transaction, also when several processes try at once. A copy of the old journal is kept.
pub(super) fn migrate(connection: &mut Connection, path: &Path) -> Result<(), StoreFault> {
    if format_version(connection)? == CURRENT_FORMAT {
        return Ok(());
    }
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let found = format_version(&transaction)?;
    let missing = usize::try_from(found).ok().and_then(|done| MIGRATIONS.get(done..));
    let missing = missing.ok_or(StoreFault::NewerFormat { found, known: CURRENT_FORMAT })?;
    if missing.is_empty() {
        // Another process has migrated it.
        return Ok(());
    }
    if found > 0 {
        copy_journal_before_migration(path, found)?;
    }
    // The checksums below must not hide a damaged row.
    if found >= format_identification::FIRST_FORMAT_WITH_APPLICATION_ID {
        checksum::verify_all_rows(&transaction)?;
    }
    for migration in missing {
        transaction.execute_batch(migration)?;
    }
    checksum::compute_all_checksums(&transaction)?;
    format_identification::write_application_id_and_format(&transaction, CURRENT_FORMAT)?;
    Ok(transaction.commit()?)
}

/// Copies the journal at `path`, of format `found`, before the migration to a file beside it.
fn copy_journal_before_migration(path: &Path, found: i64) -> Result<(), StoreFault> {
    let now = Timestamp::now().strftime("%Y%m%dT%H%M%SZ");
    let source = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
    // A process that was killed during a migration may have made a copy within the same second.
    for number in 1.. {
        let number = if number == 1 { String::new() } else { format!("-{number}") };
        let kept = path.with_file_name(format!("journal-v{found}-{now}{number}.sqlite"));
        match verified_copy::copy_verified(&source, &kept, |_| Ok(())) {
            Err(StoreFault::FileExists) => {}
            ended => return ended,
        }
    }
    Ok(())
}
