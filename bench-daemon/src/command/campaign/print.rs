//! Prints campaigns as text.

use analysis::batch::{Cells, TableColumn};

use bench_evaluate::campaign::{
    CampaignFile, CampaignReport, CorrectedCell, Design, LeftOut, Quantity,
};
use bench_plan::support::terminal::say;

/// Cells that are listed by name, at most.
const LISTED: usize = 10;

/// The benches and what each of them measures.
pub(super) fn design(file: &CampaignFile, design: &Design) {
    say!(
        "campaign {}: {} cells, each on {} of {} benches, {} references; {} runs",
        file.name,
        file.cells.len(),
        file.benches_per_cell,
        file.benches.len(),
        file.references.len(),
        design.len()
    );
    for (bench, visits) in file.benches.iter().zip(&design.benches) {
        let references = visits.iter().filter(|visit| visit.is_reference).count();
        say!(
            "{}  {} runs, {references} of them of references",
            bench.name,
            visits.len()
        );
    }
}

/// A share as percent.
fn percent(share: f64) -> String {
    format!("{:.3} %", 100.0 * share)
}

/// Result of a campaign.
pub(super) fn report(judged: &CampaignReport) {
    say!(
        "campaign {}: {} models with {} RC pairs",
        judged.campaign,
        judged.values,
        judged.rc
    );
    for LeftOut { why, runs } in &judged.left_out {
        say!("  left out: {runs} runs, {why}");
    }
    for quantity in &judged.quantities {
        self::quantity(quantity);
    }
}

fn quantity(quantity: &Quantity) {
    say!("");
    say!(
        "{}: mean {:.6} ± {:.6} {}",
        quantity.name,
        quantity.mean,
        quantity.mean_sigma,
        quantity.unit
    );
    for one in &quantity.spread {
        let high = one.high.map_or("∞".to_owned(), percent);
        say!(
            "  {:<8}  standard deviation {}, 95 % from {} to {high}  ({} levels)",
            one.name,
            percent(one.sd),
            percent(one.low),
            one.levels
        );
    }
    for bench in &quantity.benches {
        let mark = if bench.is_outlier { "  outlier" } else { "" };
        say!(
            "  bench {}: {:+.3} % ± {:.3} %, {} values{mark}",
            bench.bench,
            100.0 * bench.offset,
            100.0 * bench.sigma,
            bench.values
        );
    }
    let outliers: Vec<_> = quantity
        .cells
        .iter()
        .filter(|cell| cell.is_outlier)
        .collect();
    for cell in outliers.iter().take(LISTED) {
        say!(
            "  outlier: {} at {:.6} ± {:.6} {} ({:+.1} σ)",
            cell.cell,
            cell.corrected,
            cell.sigma,
            quantity.unit,
            cell.z
        );
    }
    if outliers.len() > LISTED {
        say!("  and {} more outliers", outliers.len() - LISTED);
    }
}

/// The cells of all quantities as the columns of a table.
pub(super) fn cell_columns(judged: &CampaignReport) -> Vec<TableColumn> {
    let rows: Vec<(&Quantity, &CorrectedCell)> = judged
        .quantities
        .iter()
        .flat_map(|quantity| quantity.cells.iter().map(move |cell| (quantity, cell)))
        .collect();
    let texts = |name, of: &dyn Fn(&Quantity, &CorrectedCell) -> Option<String>| TableColumn {
        name,
        cells: Cells::Texts(rows.iter().map(|(a, b)| of(a, b)).collect()),
    };
    let numbers = |name, of: &dyn Fn(&CorrectedCell) -> f64| TableColumn {
        name,
        cells: Cells::Numbers(rows.iter().map(|(_, cell)| Some(of(cell))).collect()),
    };
    let counts = |name, of: &dyn Fn(&CorrectedCell) -> usize| TableColumn {
        name,
        cells: Cells::Counts(rows.iter().map(|(_, cell)| count(of(cell))).collect()),
    };
    vec![
        texts("quantity", &|quantity, _| Some(quantity.name.to_owned())),
        texts("unit", &|quantity, _| Some(quantity.unit.to_owned())),
        texts("cell", &|_, cell| Some(cell.cell.clone())),
        texts("batch", &|_, cell| cell.batch.clone()),
        counts("values", &|cell| cell.values),
        numbers("measured", &|cell| cell.measured),
        numbers("corrected", &|cell| cell.corrected),
        numbers("sigma", &|cell| cell.sigma),
        numbers("z", &|cell| cell.z),
        counts("outlier", &|cell| usize::from(cell.is_outlier)),
    ]
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}
