//! `eis-bench fit --under-current`: sweeps under a direct current against those at rest.

use std::path::Path;

use analysis::{
    fit::CellSweeps,
    plot,
    report::{Figure, Level, Report, Table, Verdict},
    run_folder,
    spectrum::{SourcedSpectrum, Spectrum},
    under_current::{
        BranchChange, CurrentChange, UnderCurrent, UnderCurrentOptions, change_chart, in_words,
        share_chart, tau_in_words, under_current,
    },
    validity::assess,
};

use super::{
    circuit::CircuitArgs,
    input::{FitArgs, Spectra, read_all},
};
use crate::command::printed::say_json;
use bench_core::safety::failure::Failure;
use bench_evaluate::{files, support::present::significant};
use bench_plan::support::terminal::say;

/// Names of the result and the pictures in the folder.
const RESULT: &str = "under_current.json";
const CHANGE: &str = "under_current_change";
const SHARES: &str = "under_current_shares";
const NYQUIST: &str = "under_current_nyquist";

/// Compares sweeps under a direct current with those at rest.
///
/// # Errors
/// A file or an argument that is not as expected; nothing to compare; a folder that cannot be written.
pub(super) fn compare(args: &FitArgs) -> Result<(), Failure> {
    let options = UnderCurrentOptions {
        rc: order(&args.rc)?,
        same_cell: args.same_cell,
        seed: args.seed,
    };
    let Spectra { cells, biased, .. } = read_all(args)?;
    let found = under_current(&cells, &biased, &options)
        .map_err(|error| Failure::Usage(format!("--under-current: {error}")))?;
    if let Some(folder) = &args.out {
        write(
            folder,
            &Compared {
                cells: &cells,
                biased: &biased,
                found: &found,
            },
        )?;
    }
    if args.json {
        return say_json(&found);
    }
    print(&found);
    if let Some(folder) = &args.out {
        say!("written to {}", folder.display());
    }
    Ok(())
}

/// Refuses arguments that ask for something else than a comparison.
pub(super) fn refuse_others(args: &FitArgs) -> Result<(), Failure> {
    let CircuitArgs { circuit, .. } = &args.circuit;
    let others = [
        ("--pool", args.pool),
        ("--circuit", circuit.is_some()),
        ("--table", args.many.table.is_some()),
        ("--profile", args.more.profile),
        ("--seeds", args.more.seeds.is_some()),
        ("--starts", args.more.starts.is_some()),
    ];
    match others.iter().find(|(_, given)| *given) {
        Some((name, _)) => Err(Failure::Usage(format!(
            "{name}: expected no --under-current beside it: it compares resistances of one model"
        ))),
        None => Ok(()),
    }
}

fn order(text: &str) -> Result<Option<usize>, Failure> {
    if text == "auto" {
        return Ok(None);
    }
    let order = text
        .parse()
        .ok()
        .filter(|rc| (1..=analysis::fit::MAX_RC).contains(rc));
    order.map(Some).ok_or_else(|| {
        Failure::Usage(format!(
            "--rc: expected `auto` or one number from 1 to {} beside --under-current, found {text:?}",
            analysis::fit::MAX_RC
        ))
    })
}

fn print(found: &UnderCurrent) {
    say!(
        "{} sweeps of {} cells at rest, model with {} RC, χ² {} per degree of freedom",
        found.sweeps,
        found.cells,
        found.model.branches.len(),
        significant(found.chi2_at_rest, 2)
    );
    let table = changes_table(found);
    let widths: Vec<usize> = (0..table.header.len())
        .map(|column| {
            let cells = std::iter::once(&table.header).chain(&table.rows);
            cells
                .filter_map(|row| row.get(column))
                .map(|c| c.chars().count())
                .max()
                .unwrap_or(0)
        })
        .collect();
    for row in std::iter::once(&table.header).chain(&table.rows) {
        let cells = row
            .iter()
            .zip(&widths)
            .map(|(cell, width)| format!("{cell:<width$}"));
        say!("  {}", cells.collect::<Vec<_>>().join("  ").trim_end());
    }
    for change in &found.changes {
        for point in &change.flagged {
            let hz = significant(point.freq_hz, 4);
            say!(
                "note: {}, {hz} Hz left out: {}",
                change.name,
                point.reasons.join("; ")
            );
        }
        if let [first, ..] = change.left_out_hz.as_slice() {
            say!(
                "note: {}: {} frequencies from {} Hz left out, which the sweeps at rest do not have",
                change.name,
                change.left_out_hz.len(),
                significant(*first, 4)
            );
        }
    }
    for sentence in in_words(found) {
        say!("{sentence}");
    }
}

/// Returns one row for each resistance of each sweep and each pair.
fn changes_table(found: &UnderCurrent) -> Table {
    let row = |name: &str, index: usize, branch: &BranchChange| {
        let percent = |v: f64| format!("{:.1} %", 100.0 * v);
        let numbers = if branch.measured {
            [
                percent(branch.share),
                percent(branch.sigma),
                format!("{:.1}", branch.sigmas()),
                branch.freedom.to_string(),
                significant(branch.p, 2),
                significant(branch.p_adjusted, 2),
            ]
        } else {
            ["not determined", "–", "–", "–", "–", "–"].map(str::to_owned)
        };
        let tau = tau_in_words(found, index);
        let resistance = format!("{} {tau}", branch.name);
        let resistance = resistance.trim_end().to_owned();
        [name.to_owned(), resistance]
            .into_iter()
            .chain(numbers)
            .collect::<Vec<String>>()
    };
    let rows_of = |name: &str, branches: &[BranchChange]| -> Vec<Vec<String>> {
        branches
            .iter()
            .enumerate()
            .map(|(k, branch)| row(name, k, branch))
            .collect()
    };
    let changes = found
        .changes
        .iter()
        .flat_map(|c| rows_of(&format!("{:+} A ({})", c.bias_a, c.name), &c.branches));
    let pairs = found
        .pairs
        .iter()
        .flat_map(|p| rows_of(&format!("{} − {}", p.to, p.from), &p.branches));
    let header = [
        "sweep",
        "resistance",
        "change",
        "σ",
        "change / σ",
        "dof",
        "p",
        "p, adjusted",
    ];
    Table {
        caption:
            "Change of each resistance from rest; the capacitances are held. p is adjusted for the \
                  number of changes tested (Holm)."
                .to_owned(),
        header: header.map(str::to_owned).to_vec(),
        rows: changes.chain(pairs).collect(),
    }
}

/// What the page is made of.
struct Compared<'a> {
    cells: &'a [SourcedSpectrum],
    biased: &'a [SourcedSpectrum],
    found: &'a UnderCurrent,
}

fn write(folder: &Path, compared: &Compared<'_>) -> Result<(), Failure> {
    let found = compared.found;
    files::make_folder(folder)?;
    let json = serde_json::to_string_pretty(found)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    files::write_text(folder, RESULT, &json)?;
    let (change, shares) = (change_chart(found), plot::Drawing::Bars(share_chart(found)));
    let nyquist = nyquist(compared);
    files::write_chart(folder, CHANGE, &change)?;
    files::write_picture(folder, SHARES, |path| shares.write(path))?;
    files::write_picture(folder, NYQUIST, |path| plot::nyquist(&nyquist, path))?;
    let drawn = |error: plot::PlotError| Failure::Analysis(error.to_string());
    let figure = |svg: String, caption: &str| Figure {
        svg,
        caption: caption.to_owned(),
    };
    let figures = vec![
        figure(
            plot::nyquist_svg(&nyquist).map_err(drawn)?,
            "Sweeps under a direct current over those at rest; both axes have the same scale.",
        ),
        figure(
            plot::chart_svg(&change).map_err(drawn)?,
            "Change of each point from the mean at rest.",
        ),
        figure(shares.svg().map_err(drawn)?, "Change of each resistance."),
    ];
    let report = Report {
        title: "Impedance under a direct current".to_owned(),
        verdicts: verdicts(compared),
        figures,
        tables: vec![changes_table(found), flagged_table(found)],
        provenance: vec![
            (
                "program".to_owned(),
                format!("eis-bench {}", env!("CARGO_PKG_VERSION")),
            ),
            ("sweeps at rest".to_owned(), names(compared.cells)),
            (
                "sweeps under a direct current".to_owned(),
                names(compared.biased),
            ),
            (
                "model".to_owned(),
                format!("{} RC", found.model.branches.len()),
            ),
        ],
        ..Report::default()
    };
    let html = report
        .to_html()
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    files::write_text(folder, run_folder::REPORT, &html)
}

fn names(of: &[SourcedSpectrum]) -> String {
    let names: Vec<&str> = of.iter().map(|one| one.spectrum.name.as_str()).collect();
    names.join(", ")
}

/// Returns the outcome in sentences, then the judgement of each spectrum by itself.
fn verdicts(compared: &Compared<'_>) -> Vec<Verdict> {
    let found = compared.found;
    let is_poor = |change: &CurrentChange| change.chi2 > 2.0 * found.chi2_at_rest.max(1.0);
    let mut verdicts: Vec<Verdict> = in_words(found)
        .into_iter()
        .map(|text| Verdict {
            level: Level::Note,
            text,
        })
        .collect();
    verdicts.extend(found.changes.iter().filter(|c| is_poor(c)).map(|change| Verdict {
        level: Level::Note,
        text: format!(
            "{}: χ² {} per degree of freedom against {} at rest: the sweep scatters more, or more than \
            resistances changes; its uncertainties are widened by the root",
            change.name,
            significant(change.chi2, 2),
            significant(found.chi2_at_rest, 2)
        ),
    }));
    let judged = compared.biased.iter().filter_map(|one| {
        let assessed = assess(std::slice::from_ref(&one.spectrum), &[]).ok()?;
        let verdict = &assessed.spectra.first()?.verdict;
        Some(Verdict {
            level: Level::Note,
            text: format!("Kramers–Kronig of {}: {}", one.spectrum.name, verdict.text),
        })
    });
    verdicts.extend(judged);
    verdicts
}

fn flagged_table(found: &UnderCurrent) -> Table {
    let rows = found.changes.iter().flat_map(|change| {
        let row = |hz: f64, why: String| vec![change.name.clone(), significant(hz, 4), why];
        let trend = change
            .flagged
            .iter()
            .map(move |point| row(point.freq_hz, point.reasons.join("; ")));
        let other = change.left_out_hz.iter();
        trend.chain(other.map(move |hz| {
            row(
                *hz,
                "the sweeps at rest do not have this frequency".to_owned(),
            )
        }))
    });
    Table {
        caption: "Points left out.".to_owned(),
        header: ["sweep", "frequency / Hz", "reason"]
            .map(str::to_owned)
            .to_vec(),
        rows: rows.collect(),
    }
}

/// Draws the cells at rest as clouds and the sweeps under a direct current over them.
fn nyquist(compared: &Compared<'_>) -> plot::ImpedancePlot {
    let cells = CellSweeps::sort(compared.cells);
    let sweeps: Vec<&Spectrum> = cells.iter().flat_map(|cell| &cell.sweeps).collect();
    let label = format!("at rest, {} sweeps of {} cells", sweeps.len(), cells.len());
    let rest = sweeps.iter().enumerate().map(|(k, sweep)| {
        let label = (k == 0).then_some(label.as_str());
        sweep
            .series(7)
            .styled(plot::SeriesStyle::Cloud)
            .labelled(label)
    });
    let mut order: Vec<&SourcedSpectrum> = compared.biased.iter().collect();
    order.sort_by(|a, b| {
        a.origin
            .bias_a
            .unwrap_or(0.0)
            .total_cmp(&b.origin.bias_a.unwrap_or(0.0))
    });
    let biased = order.into_iter().enumerate().map(|(k, one)| {
        let label = format!(
            "{:+} A ({})",
            one.origin.bias_a.unwrap_or(0.0),
            one.spectrum.name
        );
        one.spectrum.series(k).labelled(Some(&label))
    });
    let series = rest.chain(biased).collect();
    plot::ImpedancePlot::new(
        "Impedance under a direct current",
        "axes equally scaled",
        series,
    )
}
