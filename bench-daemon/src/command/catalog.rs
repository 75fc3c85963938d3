//! `eis-bench catalog`: builds a catalogue of run folders, queries it and writes it as tables.

mod args;
mod print;

use analysis::{
    batch,
    catalog::{
        Catalog, CatalogError,
        ageing::Ageing,
        export::{fit_columns, run_columns},
        scan::ScanOptions,
    },
    plot::chart,
};

use super::printed::say_json;
use args::{Act, AgeingArgs, CellsArgs, ExportArgs, FindArgs, ScanArgs, ShowArgs, Table};
use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use bench_plan::support::terminal::{remark, say};

pub use args::CatalogArgs;

/// Builds a catalogue, or answers a question.
///
/// # Errors
/// A catalogue or a folder that is not there; an argument that is not as expected.
pub fn catalog(args: &CatalogArgs) -> Result<(), Failure> {
    match &args.act {
        Act::Scan(args) => scan(args),
        Act::Find(args) => find(args),
        Act::Cells(args) => cells(args),
        Act::Show(args) => show(args),
        Act::Export(args) => export(args),
        Act::Ageing(args) => ageing(args),
    }
}

#[expect(clippy::needless_pass_by_value, reason = "a function of `map_err`")]
fn failed(error: CatalogError) -> Failure {
    Failure::Usage(error.to_string())
}

fn scan(args: &ScanArgs) -> Result<(), Failure> {
    let catalog = Catalog::make(&args.catalog).map_err(failed)?;
    let scanned = catalog
        .scan(&args.roots, &ScanOptions::plain())
        .map_err(failed)?;
    let forgotten = match args.forget_missing {
        true => catalog.forget_missing().map_err(failed)?,
        false => 0,
    };
    if args.json {
        return say_json(&scanned);
    }
    say!(
        "{}: {} runs, {} of them read, {} damaged; {} diagnoses",
        args.catalog.display(),
        scanned.runs,
        scanned.read,
        scanned.damaged,
        scanned.diagnoses
    );
    if scanned.vanished > 0 {
        say!(
            "{} run folders are not there any more: their runs are marked as missing",
            scanned.vanished
        );
    }
    if forgotten > 0 {
        say!("{forgotten} missing runs are taken out");
    }
    for reason in &scanned.unreadable {
        remark!("eis-bench: not looked into: {reason}");
    }
    Ok(())
}

fn find(args: &FindArgs) -> Result<(), Failure> {
    let catalog = Catalog::open(&args.catalog).map_err(failed)?;
    let filter = args.filter.filter(args.page.after.clone(), args.page.most);
    let found = catalog.runs(&filter).map_err(failed)?;
    if args.json {
        return say_json(&found);
    }
    if args.csv {
        let text = batch::csv_text(&run_columns(&found.runs));
        let text = text.map_err(|error| Failure::Analysis(error.to_string()))?;
        say!("{}", text.trim_end());
    } else {
        print::runs(&found.runs);
    }
    tell_more(found.after.as_deref());
    Ok(())
}

fn cells(args: &CellsArgs) -> Result<(), Failure> {
    let catalog = Catalog::open(&args.catalog).map_err(failed)?;
    let filter = args.filter.filter(args.page.after.clone(), args.page.most);
    let found = catalog.cells(&filter).map_err(failed)?;
    if args.json {
        return say_json(&found);
    }
    print::cells(&found.cells);
    tell_more(found.after.as_deref());
    Ok(())
}

/// Prints how to request the rest of a long reply.
fn tell_more(after: Option<&str>) {
    if let Some(after) = after {
        remark!("there are more: go on with --after {after}");
    }
}

fn show(args: &ShowArgs) -> Result<(), Failure> {
    let catalog = Catalog::open(&args.catalog).map_err(failed)?;
    let shown = catalog.show(&args.run).map_err(failed)?;
    if args.json {
        return say_json(&shown);
    }
    print::run(&shown);
    Ok(())
}

fn export(args: &ExportArgs) -> Result<(), Failure> {
    let catalog = Catalog::open(&args.catalog).map_err(failed)?;
    let filter = args.filter.filter(None, 0);
    let exported = match args.table {
        Table::Spectra => catalog.export_spectra(&args.out, &filter),
        Table::Runs => catalog.export_runs(&args.out, &filter),
        Table::Fits => catalog.export_fits(&args.out, &filter),
        Table::Diagnoses => catalog.export_diagnoses(&args.out, &filter),
    };
    let exported = exported.map_err(failed)?;
    if args.json {
        return say_json(&exported);
    }
    say!("{}: {} rows", args.out.display(), exported.rows);
    for reason in &exported.left_out {
        remark!("eis-bench: left out: {reason}");
    }
    Ok(())
}

fn ageing(args: &AgeingArgs) -> Result<(), Failure> {
    let catalog = Catalog::open(&args.catalog).map_err(failed)?;
    if args.filter.names_no_cell() {
        return Err(Failure::Usage(
            "--cell: expected the name or serial number of a cell, found none".to_owned(),
        ));
    }
    let filter = args.filter.filter(None, 0);
    let ageing = catalog.ageing(&filter, args.rc).map_err(failed)?;
    if ageing.points.is_empty() {
        return Err(Failure::Usage(no_fits(&ageing, args.rc)));
    }
    if ageing.serials.len() > 1 && !args.filter.names_serial() {
        return Err(Failure::Usage(several_cells(&ageing)));
    }
    if let Some(folder) = &args.out {
        write(folder, &ageing)?;
    }
    if args.json {
        return say_json(&ageing);
    }
    print::ageing(&ageing);
    Ok(())
}

fn no_fits(ageing: &Ageing, rc: Option<u32>) -> String {
    match rc.filter(|_| !ageing.orders.is_empty()) {
        Some(rc) => format!(
            "--rc: expected a number of RC pairs that models of {} have ({:?}), found {rc}",
            ageing.cell, ageing.orders
        ),
        None => format!(
            "--cell: expected a cell with fitted models in the catalogue, found none of {:?}{}",
            ageing.cell,
            match ageing.pooled {
                0 => String::new(),
                pooled => format!(
                    "; {pooled} models of its runs are of several cells together, and of none of them"
                ),
            }
        ),
    }
}

fn several_cells(ageing: &Ageing) -> String {
    let cells: Vec<String> = ageing
        .serials
        .iter()
        .map(|one| format!("{one:?}"))
        .collect();
    format!(
        "--serial: expected one of {}, for these cells have the same name {:?}, found none",
        cells.join(", "),
        ageing.cell
    )
}

/// Table and pictures of a cell over its runs.
fn write(folder: &std::path::Path, ageing: &Ageing) -> Result<(), Failure> {
    files::make_folder(folder)?;
    let fits: Vec<_> = ageing.points.iter().map(|one| one.fit.clone()).collect();
    batch::write_table(&folder.join("ageing.csv"), &fit_columns(&fits))
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    for name in ["ageing.svg", "ageing.png"] {
        chart(&ageing.chart(), &folder.join(name))
            .map_err(|error| Failure::Analysis(error.to_string()))?;
    }
    Ok(())
}
