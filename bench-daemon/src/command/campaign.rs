//! `eis-bench campaign`: plans a campaign over cells and benches, and judges it.

mod args;
mod print;

use analysis::{
    batch::write_table,
    catalog::Catalog,
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
};

use serde::Serialize;

use super::printed::say_json;
use args::{Act, PlanArgs, ReportArgs};
use bench_core::safety::failure::Failure;
use bench_evaluate::{
    campaign::{CampaignFile, CampaignReport, Design, Quantity, Visit, report},
    files,
};
use bench_plan::{config::ConfigError, support::terminal::say};

pub use args::CampaignArgs;

/// Plans or judges a campaign.
///
/// # Errors
/// A file that is not as expected; a catalogue without the campaign.
pub fn campaign(args: &CampaignArgs) -> Result<(), Failure> {
    match &args.act {
        Act::Plan(args) => plan(args),
        Act::Report(args) => judge(args),
    }
}

fn plan(args: &PlanArgs) -> Result<(), Failure> {
    let file = CampaignFile::read(&args.file)?;
    let design = Design::of(&file);
    if args.json {
        return say_json(&PlannedCampaign::of(&file, &design)?);
    }
    print::design(&file, &design);
    if let Some(out) = &args.out {
        let written = file.write(&design, out)?;
        say!("{} experiments in {}", written.len(), out.display());
    }
    Ok(())
}

/// The experiments of a campaign, for another program.
#[derive(Serialize)]
struct PlannedCampaign<'a> {
    campaign: &'a str,
    experiments: Vec<PlannedVisit<'a>>,
}

/// An experiment of a campaign.
#[derive(Serialize)]
struct PlannedVisit<'a> {
    bench: &'a str,
    cell: &'a str,
    seed: u64,
    text: String,
}

impl<'a> PlannedCampaign<'a> {
    /// Takes the benches in turn, so that no bench waits for the whole plan of another.
    fn of(file: &'a CampaignFile, design: &'a Design) -> Result<Self, ConfigError> {
        let turns = design.benches.iter().map(Vec::len).max().unwrap_or(0);
        let visits =
            (0..turns).flat_map(|turn| design.benches.iter().filter_map(move |all| all.get(turn)));
        let planned = |visit: &'a Visit| {
            Ok(PlannedVisit {
                bench: &file.benches[visit.bench].name,
                cell: &visit.cell.name,
                seed: file.seed_of(visit),
                text: file.text(visit, None, str::to_owned)?,
            })
        };
        Ok(Self {
            campaign: &file.name,
            experiments: visits.map(planned).collect::<Result<_, _>>()?,
        })
    }
}

fn judge(args: &ReportArgs) -> Result<(), Failure> {
    let failed = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
    let paths = [&args.catalog].into_iter().chain(&args.and);
    let catalogs: Result<Vec<Catalog>, _> = paths.map(|path| Catalog::open(path)).collect();
    let catalogs = catalogs.map_err(|error| failed(&error))?;
    let judged = report(&catalogs, &args.campaign, args.rc).map_err(|error| failed(&error))?;
    if args.json {
        say_json(&judged)?;
    } else {
        print::report(&judged);
    }
    match &args.out {
        Some(out) => write(out, &judged),
        None => Ok(()),
    }
}

/// Table of the cells, and pictures.
fn write(folder: &std::path::Path, judged: &CampaignReport) -> Result<(), Failure> {
    files::make_folder(folder)?;
    write_table(&folder.join("cells.csv"), &print::cell_columns(judged))
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    files::write_chart(folder, "campaign", &picture(judged))
}

/// Each cell as measured and as corrected, in the order of its value, and each bench's offset.
fn picture(judged: &CampaignReport) -> Chart {
    let panels = judged
        .quantities
        .iter()
        .take(2)
        .flat_map(|quantity| [cells_panel(quantity), benches_panel(quantity)]);
    let title = format!("Campaign {}", judged.campaign);
    let subtitle = format!(
        "{} models with {} RC pairs; bars are one standard uncertainty",
        judged.values, judged.rc
    );
    Chart::new(&title, &subtitle, panels.collect())
}

fn cells_panel(quantity: &Quantity) -> Panel {
    let mut cells: Vec<_> = quantity.cells.iter().collect();
    cells.sort_by(|a, b| a.corrected.total_cmp(&b.corrected));
    let numbered = |of: &dyn Fn(usize) -> f64| {
        (0..cells.len())
            .map(|at| ((at + 1) as f64, of(at)))
            .collect::<Vec<(f64, f64)>>()
    };
    let percent = |value: f64| 100.0 * (value / quantity.mean - 1.0);
    let spread = cells
        .iter()
        .map(|cell| 100.0 * cell.sigma / quantity.mean)
        .collect();
    let measured = numbered(&|at| percent(cells[at].measured));
    let corrected = numbered(&|at| percent(cells[at].corrected));
    Panel::new(
        AxisSpec::linear("Cells in the order of their value"),
        AxisSpec::linear(&format!("{} / % of the mean", quantity.name)),
        vec![
            Trace::new("as measured", 1, TraceStyle::Points, measured),
            Trace::new("corrected for the bench", 0, TraceStyle::Points, corrected)
                .with_spread(spread),
        ],
    )
}

fn benches_panel(quantity: &Quantity) -> Panel {
    let benches = (1..).zip(&quantity.benches);
    let points = benches.map(|(at, bench)| (f64::from(at), 100.0 * bench.offset));
    let spread = quantity.benches.iter().map(|bench| 100.0 * bench.sigma);
    Panel::new(
        AxisSpec::linear("Benches in the order of the table"),
        AxisSpec::linear(&format!("offset of {} / %", quantity.name)),
        vec![
            Trace::new("bench", 2, TraceStyle::Points, points.collect())
                .with_spread(spread.collect()),
        ],
    )
}
