//! Finds the starts of sweeps, and rows where the frequency reverses or is measured again.

/// Relative difference below which two frequencies are the same. Half a step of a grid with 100
/// points per decade is 1.2 %; generators round much more finely.
const SAME: f64 = 0.01;
/// Minimum number of points of a run that returns to the start and counts as a separate sweep: two
/// points, which define a direction, and one that reverses it.
const FEWEST: usize = 3;

/// Findings from the order of frequencies, by row.
#[derive(Debug)]
pub(super) struct Cuts {
    /// Starts of sweeps.
    pub(super) starts: Vec<usize>,
    /// Rows that repeat a frequency of their sweep after other frequencies.
    pub(super) again: Vec<usize>,
    /// Starts of runs that reverse within their sweep without repeating a frequency.
    pub(super) turns: Vec<usize>,
    /// Rows with exactly the frequency of the previous row.
    pub(super) still: Vec<usize>,
}

pub(super) fn cuts(freqs: &[f64]) -> Cuts {
    let mut cuts = Cuts {
        starts: vec![0],
        again: Vec::new(),
        turns: Vec::new(),
        still: Vec::new(),
    };
    let runs = runs(freqs);
    let mut start = 0;
    for run in runs.iter().skip(1) {
        let (sweep, next) = (&freqs[start..run.start], &freqs[run.start..run.end]);
        if measures_again(sweep, next) {
            start = run.start;
            cuts.starts.push(start);
        } else {
            let known = distinct(sweep);
            let before = cuts.again.len();
            cuts.again
                .extend((run.start..run.end).filter(|row| holds(&known, freqs[*row])));
            if cuts.again.len() == before {
                cuts.turns.push(run.start);
            }
        }
    }
    // At the start of a sweep, the frequency may repeat.
    let stands = |row: &usize| freqs[*row] == freqs[row - 1] && !cuts.starts.contains(row);
    cuts.still = (1..freqs.len()).filter(stands).collect();
    cuts
}

/// Rows whose frequency moves in one direction; equal frequencies are not a move.
#[derive(Debug, Clone, Copy)]
struct Run {
    start: usize,
    end: usize,
    /// Greater than zero for rising; zero for one frequency only.
    direction: i8,
}

fn runs(freqs: &[f64]) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    // The current run, and the frequency from which its moves are counted.
    let (mut run, mut anchor) = (
        Run {
            start: 0,
            end: 0,
            direction: 0,
        },
        freqs.first().copied().unwrap_or(1.0),
    );
    for (row, freq) in freqs.iter().enumerate() {
        let step = match freq.total_cmp(&anchor) {
            _ if same(*freq, anchor) => 0,
            std::cmp::Ordering::Greater => 1,
            _ => -1,
        };
        if step != 0 {
            if run.direction != 0 && step != run.direction {
                runs.push(Run { end: row, ..run });
                run = Run {
                    start: row,
                    end: row,
                    direction: 0,
                };
            } else {
                run.direction = step;
            }
            anchor = *freq;
        }
    }
    runs.push(Run {
        end: freqs.len(),
        ..run
    });
    // A frequency that is measured twice at the reversal of a sweep belongs to both directions.
    for k in 1..runs.len() {
        let (before, after) = (runs[k - 1], runs[k]);
        let turn = after.start;
        let turns = before.direction * after.direction < 0;
        if turns && turn >= before.start + 2 && same(freqs[turn - 1], freqs[turn - 2]) {
            runs[k - 1].end -= 1;
            runs[k].start -= 1;
        }
    }
    runs
}

/// Returns whether a run repeats a sweep, by the rule of the module.
fn measures_again(sweep: &[f64], run: &[f64]) -> bool {
    if run.len() < FEWEST && sweep.len() > FEWEST {
        return false;
    }
    let (known, new) = (distinct(sweep), distinct(run));
    let longer = known.len().max(new.len());
    let shared = new.iter().filter(|freq| holds(&known, **freq)).count();
    let within = |these: &[f64], those: &[f64]| {
        let (low, high) = (
            those[0] * (1.0 - SAME),
            those[those.len() - 1] * (1.0 + SAME),
        );
        these
            .iter()
            .filter(|freq| (low..=high).contains(*freq))
            .count()
    };
    let covered = within(&new, &known).min(within(&known, &new));
    let from_the_start = [run[0], run[run.len() - 1]]
        .into_iter()
        .any(|freq| same(freq, sweep[0]));
    let all = shared >= 2 && known.len() == shared && new.len() == shared;
    all || (shared >= FEWEST && 2 * shared > longer)
        || (from_the_start && covered >= FEWEST && 4 * covered >= longer)
}

/// Returns the distinct frequencies in rising order; not empty unless the list is.
pub(super) fn distinct(freqs: &[f64]) -> Vec<f64> {
    let mut sorted = freqs.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup_by(|a, b| same(*a, *b));
    sorted
}

/// Returns whether sorted frequencies contain one.
fn holds(sorted: &[f64], freq: f64) -> bool {
    let above = sorted.partition_point(|known| *known < freq);
    sorted
        .iter()
        .skip(above.saturating_sub(1))
        .take(2)
        .any(|known| same(*known, freq))
}

fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= SAME * a.max(b)
}
