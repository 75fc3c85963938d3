//! Judges the validity of the spectra of a run. Each is tested separately, so that the first one
//! cannot hide an invalid one.

use analysis::{
    report::{Figure, Level, Table, Verdict},
    validity::{Assessed, Grade, Noise, assess_by},
};

use super::records;
use crate::{
    figures::validity,
    run::{Measured, MultisineRun},
};
use bench_core::safety::failure::Failure;
use bench_plan::config::Campaign;

/// Greatest number of spectra that are named individually.
const NAMED: usize = 4;

/// A spectrum and its verdict.
pub(super) struct Judged {
    /// Name among the spectra, if there are several.
    pub(super) name: String,
    /// The tests, or why there are none.
    pub(super) outcome: Result<Assessed, String>,
}

impl Judged {
    /// Returns the grade as one word.
    pub(super) fn grade(&self) -> String {
        self.outcome.as_ref().map_or_else(
            |_| "not tested".to_owned(),
            |assessed| assessed.verdict.grade.to_string(),
        )
    }

    /// Returns the rank: bad counts most, then doubtful, then not tested.
    fn rank(&self) -> usize {
        match self.outcome.as_ref().map(|assessed| assessed.verdict.grade) {
            Ok(Grade::Bad) => 3,
            Ok(Grade::Doubtful | Grade::CannotBeJudged) => 2,
            Err(_) => 1,
            Ok(Grade::Good) => 0,
        }
    }

    fn in_words(&self) -> String {
        match &self.outcome {
            Ok(assessed) => format!("{}: {}", assessed.verdict.grade, assessed.verdict.text),
            Err(why) => format!("not tested: {why}"),
        }
    }
}

/// Judges all spectra of the cell, each against the noise of its own records.
pub(super) fn judge(measured: &Measured, shunt_ohm: f64) -> Vec<Judged> {
    let names = measured.names();
    let judged = |((name, points), own): ((String, &Vec<_>), &analysis::spectrum::Spectrum)| {
        let tested = analysis::spectrum::Spectrum::new(name.clone(), own.points.clone());
        Judged {
            name,
            outcome: validity::tested(&tested, &records::records(points, shunt_ohm)),
        }
    };
    names
        .into_iter()
        .zip(&measured.points)
        .zip(&measured.own_noise)
        .map(judged)
        .collect()
}

/// Judges the multisines of the cell by Kramers–Kronig and Z-HIT, and includes the distortion of
/// their lines.
fn of_multisines(measured: &Measured) -> Vec<Judged> {
    let judged = |(number, run): (usize, &MultisineRun)| {
        let name = if measured.multisines.len() > 1 {
            format!("multisine {number}")
        } else {
            "multisine".to_owned()
        };
        let noise = Noise::of(&run.own_noise, &[]).map(|noise| Noise {
            dof: Some(run.noise_dof),
            ..noise
        });
        let outcome = noise
            .and_then(|noise| assess_by(&run.own_noise, &noise))
            .map_err(|error| error.to_string());
        Judged { name, outcome }
    };
    (1..).zip(&measured.multisines).map(judged).collect()
}

/// Returns the multisines as one line for report and summary, or `None` if there is none.
pub(super) fn multisine_verdict(measured: &Measured) -> Option<Verdict> {
    let judged = of_multisines(measured);
    let worst = judged.iter().map(Judged::rank).max()?;
    let level = if worst == 0 {
        Level::Good
    } else if worst == 3 {
        Level::Bad
    } else {
        Level::Note
    };
    let messages: Vec<String> = judged
        .iter()
        .map(|one| format!("{}: {}", one.name, one.in_words()))
        .collect();
    Some(Verdict {
        level,
        text: format!("Kramers–Kronig and Z-HIT, {}.", messages.join("; ")),
    })
}

/// Returns one line for report and summary.
pub(super) fn verdict(judged: &[Judged]) -> Verdict {
    let worst = judged.iter().map(Judged::rank).max().unwrap_or(1);
    let level = match worst {
        0 => Level::Good,
        3 => Level::Bad,
        _ => Level::Note,
    };
    if let [only] = judged {
        return Verdict {
            level,
            text: format!(
                "Kramers–Kronig, Z-HIT, harmonics and drift: {}.",
                only.in_words()
            ),
        };
    }
    let grades = ["good", "doubtful", "bad", "not tested"];
    let counted = grades.map(|grade| {
        (
            judged.iter().filter(|one| one.grade() == grade).count(),
            grade,
        )
    });
    let counts: Vec<String> = counted
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, grade)| format!("{count} {grade}"))
        .collect();
    let mut text = format!(
        "Kramers–Kronig, Z-HIT, harmonics and drift of {} spectra: {}",
        judged.len(),
        counts.join(", ")
    );
    let mut odd: Vec<&Judged> = judged.iter().filter(|one| one.rank() > 0).collect();
    odd.sort_by_key(|one| std::cmp::Reverse(one.rank()));
    odd.iter()
        .take(NAMED)
        .for_each(|one| text.push_str(&format!("; {}: {}", one.name, one.in_words())));
    if odd.len() > NAMED {
        text.push_str(&format!("; {} more in the table", odd.len() - NAMED));
    }
    text.push('.');
    Verdict { level, text }
}

/// Returns a table of cell by repeat, or `None` for a single spectrum.
pub(super) fn table(campaign: Option<&Campaign>, judged: &[Judged]) -> Option<Table> {
    if judged.len() < 2 {
        return None;
    }
    let caption = "Kramers–Kronig, Z-HIT, harmonics and drift: each spectrum by itself".to_owned();
    let Some(campaign) = campaign else {
        let rows = judged
            .iter()
            .map(|one| vec![one.name.clone(), one.in_words()])
            .collect();
        return Some(Table {
            caption,
            header: vec!["spectrum".to_owned(), "verdict".to_owned()],
            rows,
        });
    };
    let grade = |cell: usize, repeat: usize| {
        let run = campaign
            .runs()
            .find(|run| run.cell.number == cell && run.repeat == repeat);
        let one = run.and_then(|run| judged.iter().find(|one| one.name == run.name()));
        one.map_or_else(|| "–".to_owned(), Judged::grade)
    };
    let header = std::iter::once("cell".to_owned())
        .chain((1..=campaign.repeats).map(|repeat| format!("repeat {repeat}")));
    let row = |cell: &std::sync::Arc<bench_plan::plan::Specimen>| {
        std::iter::once(cell.name.clone())
            .chain((1..=campaign.repeats).map(|repeat| grade(cell.number, repeat)))
            .collect()
    };
    Some(Table {
        caption,
        header: header.collect(),
        rows: campaign.cells.iter().map(row).collect(),
    })
}

/// Returns pictures of the spectrum with the worst verdict, and its name if there are several.
pub(super) fn pictures(measured: &Measured, judged: &[Judged]) -> Result<Vec<Figure>, Failure> {
    let tested = judged
        .iter()
        .zip(measured.spectra())
        .filter_map(|(one, shown)| Some((one, one.outcome.as_ref().ok()?, shown)));
    let Some((one, assessed, shown)) = tested.reduce(|worst, next| {
        if next.0.rank() > worst.0.rank() {
            next
        } else {
            worst
        }
    }) else {
        return Ok(Vec::new());
    };
    let mut figures = validity::pictures(assessed, shown)?;
    if judged.len() > 1 {
        let which = format!(
            "{}, {} of {} spectra: ",
            one.name,
            if one.rank() > 0 {
                "the worst"
            } else {
                "the first"
            },
            judged.len()
        );
        figures
            .iter_mut()
            .for_each(|figure| figure.caption.insert_str(0, &which));
    }
    Ok(figures)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::plan::Specimen;

    fn judged(names: &[&str]) -> Vec<Judged> {
        names
            .iter()
            .map(|name| Judged {
                name: (*name).to_owned(),
                outcome: Err("too few points".to_owned()),
            })
            .collect()
    }

    #[test]
    fn every_spectrum_of_a_campaign_has_its_place() {
        let cell = |number, name: &str| {
            std::sync::Arc::new(Specimen {
                number,
                name: name.to_owned(),
                serial: None,
                batch: None,
                barcode: None,
            })
        };
        let campaign = Campaign {
            cells: vec![cell(1, "A"), cell(2, "B")],
            repeats: 2,
            round_robin: true,
        };
        let all = judged(&["A_1", "B_1", "A_2"]);
        let table = table(Some(&campaign), &all).unwrap();
        assert_eq!(table.header, ["cell", "repeat 1", "repeat 2"]);
        assert_eq!(
            table.rows,
            [["A", "not tested", "not tested"], ["B", "not tested", "–"]]
        );
        let judgement = verdict(&all);
        let text = "Kramers–Kronig, Z-HIT, harmonics and drift of 3 spectra: 3 not tested; A_1: \
        not tested: too few points; \
                    B_1: not tested: too few points; A_2: not tested: too few points.";
        assert_eq!(
            (judgement.level, judgement.text.as_str()),
            (Level::Note, text)
        );
        assert!(super::table(None, &all[..1]).is_none());
        assert_eq!(
            verdict(&all[..1]).text,
            "Kramers–Kronig, Z-HIT, harmonics and drift: not tested: too few points."
        );
    }
}
