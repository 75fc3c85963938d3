//! Computes the rows of a trace from its frames. The functions are pure: the same frames give the
//! same rows, from the scope or later from a run folder. The rows are judged elsewhere.

use analysis_files::{
    dataset::{Capture, TraceRow},
    thinning::{Mean, Thinned, Thinning, Window, thin},
};
use analysis_signal::calibration::Correction;

use bench_plan::plan::TracePlan;

/// The slowest supply settles within this time, s: eight time constants at 5 kHz.
pub(super) const SETTLE_S: f64 = 2.5e-4;
/// Time before and after a command in which its step appears in the record, s.
const STEP_WINDOW_S: (f64, f64) = (0.05, 0.25);

/// Settings by which the frames of a trace are read.
pub struct Frames<'a> {
    /// Plan of the trace.
    pub trace: &'a TracePlan,
    /// Correction of the harness for the channels.
    pub correction: &'a Correction,
    /// Resistance of the current shunt, Ω.
    pub shunt_ohm: f64,
    /// Voltages of channels 1…4 while no current flows, V.
    pub zero_v: [f64; 4],
    /// Voltage at rest by the voltmeter, V.
    pub ocv_v: f64,
}

/// The part of a trace that was recorded.
#[derive(Debug, Default)]
pub struct Recorded {
    /// Rows; the scope does not measure temperature.
    pub rows: Vec<TraceRow>,
    /// Commanded current of each row, A; only for rows of the scope.
    pub levels_a: Vec<f64>,
    /// Test times of the steps, s.
    pub steps_s: Vec<f64>,
    /// Squares of the scatters of current and voltage, A² and V², summed over the frames.
    pub squares: [f64; 2],
    /// Number of frames.
    pub frames: usize,
    /// Feature that the frames should contain but do not, as text: expected, measured.
    pub missing: Option<(String, String)>,
}

impl Recorded {
    /// Returns the scatter of one sample of current and voltage, A and V rms.
    pub fn scatter(&self) -> [f64; 2] {
        self.squares
            .map(|square| (square / self.frames.max(1) as f64).sqrt())
    }

    /// Appends the following part.
    pub fn append(&mut self, other: Self) {
        self.rows.extend(other.rows);
        self.levels_a.extend(other.levels_a);
        self.steps_s.extend(other.steps_s);
        self.squares = [
            self.squares[0] + other.squares[0],
            self.squares[1] + other.squares[1],
        ];
        self.frames += other.frames;
        self.missing = self.missing.take().or(other.missing);
    }
}

/// Returns the mean voltage of each channel of a frame, V; `None` for an empty frame.
pub fn zeros(capture: &Capture) -> Option<[f64; 4]> {
    let thinned = thin(
        capture,
        &[],
        &Thinning {
            settle_s: 0.0,
            first_s: 1.0,
            growth: 1.0,
            longest_s: f64::INFINITY,
        },
    );
    let [mean] = thinned.means.as_slice() else {
        return None;
    };
    Some(mean.volts)
}

impl Frames<'_> {
    /// Computes the rows of one frame. `commanded` contains bench times and the currents from then
    /// on; the first of them is the origin of test time.
    pub fn of_frame(&self, capture: &Capture, commanded: &[(f64, f64)]) -> Recorded {
        let start_s = capture.meta.start_s;
        let origin_s = commanded.first().map_or(start_s, |(at_s, _)| *at_s);
        let end_s = start_s + capture.meta.interval_s * capture.codes[0].len() as f64;
        let within = |(at_s, _): &&(f64, f64)| (start_s..end_s).contains(at_s);
        let (before_s, after_s) = STEP_WINDOW_S;
        let steps: Vec<(f64, f64)> = commanded.iter().skip(1).filter(within).copied().collect();
        let windows: Vec<Window> = steps
            .iter()
            .map(|(at_s, _)| (at_s - before_s - start_s, at_s + after_s - start_s))
            .collect();
        let (first_s, growth, longest_s) = self.trace.thinning;
        let Thinned {
            means,
            steps_s,
            sigma_shunt_v,
            sigma_jig_v,
        } = thin(
            capture,
            &windows,
            &Thinning {
                settle_s: SETTLE_S,
                first_s: first_s.0,
                growth,
                longest_s: longest_s.0,
            },
        );
        let flowing_a = commanded
            .iter()
            .take_while(|(at_s, _)| *at_s < start_s)
            .last()
            .map_or(0.0, |(_, amps)| *amps);
        let level = |mean: &Mean| {
            let passed = steps_s
                .iter()
                .filter(|step_s| **step_s < mean.time_s)
                .count();
            passed
                .checked_sub(1)
                .and_then(|index| steps.get(index))
                .map_or(flowing_a, |(_, amps)| *amps)
        };
        let row = |mean: &Mean| {
            let later_s = start_s - origin_s;
            self.row(&Mean {
                time_s: mean.time_s + later_s,
                volts: [0, 1, 2, 3].map(|slot: usize| mean.volts[slot] - self.zero_v[slot]),
                samples: mean.samples,
                averaged_s: (mean.averaged_s.0 + later_s, mean.averaged_s.1 + later_s),
            })
        };
        let sigma_a = sigma_shunt_v / self.shunt_ohm;
        Recorded {
            rows: means.iter().map(row).collect(),
            levels_a: means.iter().map(level).collect(),
            steps_s: steps_s
                .iter()
                .map(|step_s| step_s + start_s - origin_s)
                .collect(),
            squares: [sigma_a.powi(2), sigma_jig_v.powi(2)],
            frames: 1,
            missing: None,
        }
    }

    /// Returns a row of test time from the mean differences of the channels from their zeros, V.
    pub(super) fn row(&self, changed: &Mean) -> TraceRow {
        let (current_a, change_v) = self.correction.direct(changed.volts);
        TraceRow {
            time_s: changed.time_s,
            current_a,
            voltage_v: self.ocv_v + change_v,
            temperature_degc: f64::NAN,
            samples: changed.samples as f64,
            averaged_s: changed.averaged_s,
        }
    }
}
