//! Campaigns in words.

use std::fmt::Write as _;

use crate::{
    campaign::{CampaignFile, CampaignReport, Design, Quantity},
    support::terminal::say,
};

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

/// The cells as a table.
pub(super) fn cells_csv(judged: &CampaignReport) -> String {
    let mut text =
        "quantity,unit,cell,batch,values,measured,corrected,sigma,z,outlier\n".to_owned();
    for quantity in &judged.quantities {
        for cell in &quantity.cells {
            // Writing into a text cannot fail.
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{},{},{},{}",
                quantity.name,
                quantity.unit,
                cell.cell,
                cell.batch.as_deref().unwrap_or_default(),
                cell.values,
                cell.measured,
                cell.corrected,
                cell.sigma,
                cell.z,
                u8::from(cell.is_outlier)
            );
        }
    }
    text
}
