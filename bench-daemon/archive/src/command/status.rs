//! `eis-archive status`.

use super::arguments::StatusArgs;
use crate::{
    failure::Failure,
    print::{print_json, print_line},
    settings::Settings,
    status::read_status,
};

pub(super) fn print_status(args: &StatusArgs) -> Result<(), Failure> {
    let status = read_status(&Settings::load(&args.config)?)?;
    if args.json {
        return print_json(&status);
    }
    print_line(format_args!("{}, site {}", status.store, status.site));
    for (words, count) in [
        ("archived", status.archived),
        ("not there yet", status.pending),
        ("failed", status.failed),
        ("refused", status.refused),
        ("not ended", status.waiting),
    ] {
        print_line(format_args!("  {count:>8} runs {words}"));
    }
    print_line(format_args!(
        "  {} bytes, of which {} are in the store only",
        status.bytes, status.moved_bytes
    ));
    for trouble in &status.troubles {
        print_line(format_args!(
            "  {}: {}: {}",
            trouble.run, trouble.kind, trouble.why
        ));
    }
    Ok(())
}
