//! Reads the table of the links of a pack, and prints and writes their loads, for `pack simulate`.

use std::path::Path;

use analysis::{
    forward::pack::{Link, LinkLoad, LinkLoads, Links, LinksError},
    pack::Pack,
    table,
};

use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use bench_plan::support::terminal::say;

/// Links that are printed, at most.
const PRINTED: usize = 5;

/// Reads the links of a pack.
///
/// # Errors
/// A table that cannot be read, or links that are no pack.
pub(super) fn read_links(path: &Path, pack: Pack) -> Result<Links, Failure> {
    let read = table::Table::read(path, table::Hash::Comment)
        .map_err(|error| Failure::Usage(format!("--links {error}")))?;
    let fail = |line: usize, reason: &str| {
        Failure::Usage(format!("{}, line {line}: {reason}", path.display()))
    };
    let known = ["from", "to", "ohm", "heat_j_per_k"];
    let [from, to, ohm, heat] = known.map(|name| read.column(name));
    let (Some(from), Some(to), Some(ohm)) = (from, to, ohm) else {
        let found = read.columns.join(",");
        let reason = format!("expected a header with from, to, ohm, found {found:?}");
        return Err(fail(read.header_line, &reason));
    };
    let mut columns = read.columns.iter();
    if let Some(unknown) = columns.find(|name| !known.contains(&name.as_str())) {
        let reason = format!(
            "expected the columns {}, found {unknown:?}",
            known.join(", ")
        );
        return Err(fail(read.header_line, &reason));
    }
    let mut links = Vec::new();
    for row in &read.rows {
        let number = |column: usize| {
            let found = row.field(column);
            let reason = || {
                format!(
                    "expected a number in {}, found {found:?}",
                    read.columns[column]
                )
            };
            row.number(column).ok_or_else(|| fail(row.line, &reason()))
        };
        let heat = heat.filter(|heat| !row.field(*heat).is_empty());
        links.push(Link {
            from: row.field(from).to_owned(),
            to: row.field(to).to_owned(),
            r_ohm: number(ohm)?,
            heat_j_per_k: heat.map(number).transpose()?,
        });
    }
    Links::new(links, pack.series, pack.parallel).map_err(|error| match &error {
        LinksError::Link { index, .. } => fail(read.rows[*index].line, &error.to_string()),
        _ => Failure::Usage(format!("{}: {error}", path.display())),
    })
}

/// Prints the links with the most heat, and the hottest path.
pub(super) fn print_loads(loads: &LinkLoads, equivalent_ohm: f64) {
    let all_j: f64 = loads.links.iter().map(|load| load.heat_j).sum();
    say!(
        "  identical cells: {} links, as {:.2} mΩ in series with the pack; the most heat:",
        loads.links.len(),
        1e3 * equivalent_ohm
    );
    let mut hottest: Vec<&LinkLoad> = loads.links.iter().collect();
    hottest.sort_by(|a, b| b.heat_j.total_cmp(&a.heat_j));
    for load in hottest.into_iter().take(PRINTED) {
        let rise = load
            .rise_k
            .map_or_else(String::new, |rise_k| format!(", + {rise_k:.2} K"));
        say!(
            "    {:<18}{:8.3} mΩ{:9.2} A{:9.2} W{:9.3} J, {:.1} % of all{rise}",
            format!("{} to {}", load.from, load.to),
            1e3 * load.r_ohm,
            load.largest_a,
            load.r_ohm * load.largest_a.powi(2),
            load.heat_j,
            100.0 * load.heat_j / all_j
        );
    }
    say!(
        "    hottest path at {:.2} A: {}",
        loads.largest_a,
        loads.hottest_path.join(" ")
    );
}

/// Writes the loads of all links as `links.csv`.
///
/// # Errors
/// A file that cannot be written.
pub(super) fn write_loads(out: &Path, loads: &LinkLoads) -> Result<(), Failure> {
    let mut text = "from,to,ohm,largest_a,heat_j,rise_k\n".to_owned();
    for load in &loads.links {
        let number = |value: f64| format!("{value:.6}");
        text += &format!(
            "{},{},{},{},{},{}\n",
            load.from,
            load.to,
            load.r_ohm,
            number(load.largest_a),
            number(load.heat_j),
            load.rise_k.map_or_else(String::new, number)
        );
    }
    files::write_text(out, "links.csv", &text)
}
