//! Results of `eis-bench fit` beyond the fits: choice of the order, spread of cells, profiles,
//! other minima, search over many seeds.

use bench_core::{operator::progress::Waiting, safety::failure::Failure};
use bench_evaluate::{files, support::present::significant};
use bench_plan::support::terminal::say;
use std::path::Path;

use analysis::{
    fit::{
        CellSpread, ErmFit, FitError, FitOptions, LocalMinimum, OrderRow, OrderSelection, Prepared,
        Profile, QuantitySpread, SeedSurvey, cell_spread, profiles, survey_seeds,
    },
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
};
use serde::Serialize;

/// Arguments of `fit` beyond the fit itself.
#[derive(Debug, clap::Args)]
pub struct MoreArgs {
    /// Additional descents from random time constants, beside those of the global search. With
    /// --circuit: maximum number of starts of the search, which ends earlier if several agree
    /// [default: 0; with --circuit 64]
    #[arg(long, value_name = "N")]
    pub starts: Option<usize>,
    /// Repeat every search with this number of seeds; print how many reach the best optimum, and
    /// which other minima exist.
    #[arg(long, value_name = "N")]
    pub seeds: Option<u64>,
    /// Profile likelihood of every parameter and of the DC resistance: intervals that need not be
    /// symmetric.
    #[arg(long)]
    pub profile: bool,
}

/// Results of one group of spectra beyond its fit.
#[derive(Debug, Serialize)]
pub(super) struct More {
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) order_selection: Option<OrderSelection>,
    #[serde(skip_serializing_if = "Option::is_none")]
    spread: Option<CellSpread>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    profiles: Vec<FitProfiles>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    seeds: Vec<SeedSurvey>,
}

/// The profiles of one fit.
#[derive(Debug, Serialize)]
pub(super) struct FitProfiles {
    rc: usize,
    profiles: Vec<Profile>,
}

fn refused(name: &str) -> impl Fn(FitError) -> Failure + '_ {
    move |error| Failure::Usage(format!("{name}: {error}"))
}

impl More {
    /// Selects the order if requested.
    pub(super) fn choose(
        name: &str,
        prepared: &Prepared,
        auto: bool,
        seed: u64,
    ) -> Result<Self, Failure> {
        let order_selection = auto
            .then(|| prepared.select_order(seed))
            .transpose()
            .map_err(refused(name))?;
        Ok(Self {
            name: name.to_owned(),
            order_selection,
            spread: None,
            profiles: Vec::new(),
            seeds: Vec::new(),
        })
    }

    /// Adds further results that the fits allow: the spread if several sweeps of known cells were
    /// pooled, and profiles and seeds if requested.
    pub(super) fn add(
        &mut self,
        Prepared { cells, spectra }: &Prepared,
        fits: &[ErmFit],
        args: &MoreArgs,
    ) -> Result<(), Failure> {
        let options = |fit: &ErmFit| FitOptions {
            rc: fit.erm.branches.len(),
            objective: fit.objective_kind,
            bounds: fit.bounds,
            seed: fit.seed,
        };
        let orders: Vec<usize> = fits.iter().map(|f| f.erm.branches.len()).collect();
        if let Some(first) = fits
            .first()
            .filter(|_| cells.len() > 1 && cells.len() < spectra.len())
        {
            self.spread =
                Some(cell_spread(cells, &orders, &options(first)).map_err(refused(&self.name))?);
        }
        for fit in fits {
            if args.profile {
                let profiles = profiles(spectra, fit).map_err(refused(&self.name))?;
                self.profiles.push(FitProfiles {
                    rc: fit.erm.branches.len(),
                    profiles,
                });
            }
            if let Some(seeds) = args.seeds {
                let waiting = Waiting::shown();
                let what = format!("{}, {} RC: searches", self.name, fit.erm.branches.len());
                let done = waiting.counter(seeds, &what);
                let survey = survey_seeds(spectra, &options(fit), seeds, &done);
                waiting.end();
                self.seeds.push(survey.map_err(refused(&self.name))?);
            }
        }
        Ok(())
    }

    pub(super) fn is_empty(&self) -> bool {
        self.order_selection.is_none()
            && self.spread.is_none()
            && self.profiles.is_empty()
            && self.seeds.is_empty()
    }

    /// Everything as text, after the fits.
    pub(super) fn print(&self, fits: &[ErmFit]) {
        if let Some(spread) = &self.spread {
            print_spread(spread);
        }
        for FitProfiles { rc, profiles } in &self.profiles {
            print_profiles(*rc, profiles);
        }
        for survey in &self.seeds {
            let unit = fits.first().map_or("", |f| f.objective_kind.unit());
            print_survey(survey, unit);
        }
    }

    /// The curves of every fit's profiles, as `profile_Nrc.svg` and `.png`.
    pub(super) fn draw(&self, folder: &Path) -> Result<(), Failure> {
        for FitProfiles { rc, profiles } in &self.profiles {
            let chart = profile_chart(&format!("Profile likelihood, {rc} RC"), profiles);
            files::write_chart(folder, &format!("profile_{rc}rc"), &chart)?;
        }
        Ok(())
    }
}

/// The table over orders and the recommendation.
pub(super) fn print_selection(selection: &OrderSelection) {
    let OrderSelection { cells, sweeps, .. } = selection;
    let plural = |n: usize, one: &str| {
        if n == 1 {
            format!("1 {one}")
        } else {
            format!("{n} {one}s")
        }
    };
    say!(
        "  order: {}, {}, every cell fitted on its own with its repeats as noise",
        plural(*cells, "cell"),
        plural(*sweeps, "sweep")
    );
    say!(
        "    RC          χ²       AICc   F-test p    lag 1  whiteness p  lack of fit p  left-out \
        cell"
    );
    let p = |p: Option<f64>| {
        p.map_or("–".to_owned(), |p| {
            if p < 1e-99 {
                "<1e-99".to_owned()
            } else if p < 1e-4 {
                format!("{p:.0e}")
            } else {
                format!("{p:.4}")
            }
        })
    };
    for OrderRow {
        rc,
        chi2,
        aicc,
        f_test_p,
        lag1,
        whiteness_p,
        lack_of_fit_p,
        left_out_cell,
        ..
    } in &selection.rows
    {
        let mark = if *rc == selection.recommended {
            "→"
        } else {
            " "
        };
        let lag = lag1.map_or("–".to_owned(), |l| format!("{l:.2}"));
        let left = left_out_cell.map_or("–".to_owned(), |e| format!("{:.2} %", 100.0 * e));
        let chi2 = significant(*chi2, 5);
        say!(
            "  {mark} {rc:>2}  {chi2:>10} {aicc:>10.1} {:>10} {lag:>8} {:>12} {:>14} {left:>14}",
            p(*f_test_p),
            p(*whiteness_p),
            p(*lack_of_fit_p)
        );
    }
    say!(
        "    recommended: {} RC{}",
        selection.recommended,
        if selection.is_clear() {
            ""
        } else {
            ", but the data do not decide"
        }
    );
    for reason in &selection.reasons {
        say!("      {reason}");
    }
    if let Some(floor) = selection.left_out_floor {
        say!(
            "      the mean of the other cells, without any model, misses a cell by {:.2} %: so \
            much do cells differ",
            100.0 * floor
        );
    }
}

/// The other minima of a fit as one note; none when the search met none.
pub(super) fn other_minima_note(fit: &ErmFit) -> Option<String> {
    let nearest = fit.other_minima.first()?;
    let more = fit.other_minima.len() - 1;
    let more = if more == 0 {
        String::new()
    } else {
        format!(", and {more} more")
    };
    Some(format!(
        "the objective has another minimum: {}{more}; a fit that starts there stays there",
        in_words(nearest, fit.objective_kind.unit())
    ))
}

fn in_words(minimum: &LocalMinimum, unit: &str) -> String {
    let erm = &minimum.parameters;
    let tau: Vec<String> = erm
        .time_constants_s()
        .iter()
        .map(|t| significant(*t, 3))
        .collect();
    let tau = if tau.is_empty() {
        String::new()
    } else {
        format!(", τ {} s", tau.join(", "))
    };
    format!(
        "{} {unit} at R {} mΩ, DC resistance {} mΩ{tau}",
        significant(minimum.objective, 6),
        significant(1.0e3 * erm.r_ohm, 4),
        significant(1.0e3 * erm.dc_resistance_ohm(), 4)
    )
}

fn print_survey(survey: &SeedSurvey, unit: &str) {
    let SeedSurvey {
        rc,
        seeds,
        at_best,
        best,
        other_minima,
    } = survey;
    say!(
        "  {rc} RC: {at_best} of {seeds} seeds reached the best known optimum, {}",
        in_words(best, unit)
    );
    for minimum in other_minima {
        say!(
            "        local minimum: {}, {:.1} % of the descents (curvature {:.1e} > 0, promised \
            decrease {:.0e})",
            in_words(minimum, unit),
            100.0 * minimum.found_from_fraction,
            minimum.smallest_curvature,
            minimum.promised_decrease
        );
    }
}

fn print_spread(spread: &CellSpread) {
    say!(
        "  spread: {} cells, {} sweeps; standard deviations between cells and within a cell",
        spread.cells,
        spread.sweeps
    );
    say!("    f / Hz      Re Z / mΩ   between   within    Im Z / mΩ   between   within");
    let percent = |value: Option<f64>, of: f64| {
        value.map_or("–".to_owned(), |v| {
            format!("{:.2} %", 100.0 * v / of.abs())
        })
    };
    for f in &spread.frequencies {
        // The imaginary part passes near zero: both spreads are given relative to |Z|.
        let z = f.re_ohm.mean.hypot(f.im_ohm.mean);
        say!(
            "    {:<10} {:>10} {:>9} {:>8} {:>12} {:>9} {:>8}",
            significant(f.freq_hz, 4),
            significant(1e3 * f.re_ohm.mean, 4),
            percent(f.re_ohm.between, z),
            percent(f.re_ohm.within, z),
            significant(1e3 * f.im_ohm.mean, 4),
            percent(f.im_ohm.between, z),
            percent(f.im_ohm.within, z)
        );
    }
    say!("    (percent of |Z|)");
    let line = |q: &QuantitySpread| {
        let (value, unit) = if q.unit == "Ω" {
            (1e3 * q.spread.mean, "mΩ")
        } else {
            (q.spread.mean, "F")
        };
        let (between, within) = (
            percent(q.spread.between, q.spread.mean),
            percent(q.spread.within, q.spread.mean),
        );
        let (fb, fw) = q.spread.freedom;
        say!(
            "    {:<18} {:>10} {unit:<3} between {between:>8} ({fb} dof)  within {within:>8} ({fw} \
            dof)",
            q.name,
            significant(value, 5)
        );
    };
    spread.measured.iter().for_each(line);
    for order in &spread.parameters {
        say!("    {} RC, every sweep fitted on its own:", order.rc);
        order
            .quantities
            .iter()
            .filter(|q| q.identified)
            .for_each(line);
        if let Some(warning) = &order.warning {
            say!("        note: {warning}");
        }
    }
}

fn print_profiles(rc: usize, profiles: &[Profile]) {
    say!(
        "  {rc} RC, profile likelihood:            value          68 % interval                 95 \
        % interval"
    );
    for profile in profiles {
        let end = |v: Option<f64>| v.map_or("not bounded".to_owned(), |v| significant(v, 4));
        let (a, b) = (profile.interval_68, profile.interval_95);
        let value = significant(profile.value, 5);
        say!(
            "        {:<14} {value:>18} {:<2} {:>12} … {:<12} {:>12} … {:<12}",
            profile.name,
            profile.unit,
            end(a.low),
            end(a.high),
            end(b.low),
            end(b.high)
        );
    }
    for warning in profiles.iter().filter_map(Profile::warning) {
        say!("        note: {warning}");
    }
    if let Some(deeper) = profiles.iter().filter_map(|p| p.deeper).reduce(f64::min) {
        say!(
            "        note: a profile ran into a deeper minimum ({deeper:.6e}): fit again with \
            --starts"
        );
    }
}

/// Δχ² over the value relative to the fitted one, resistances above capacitances, with the limits
/// of both levels.
fn profile_chart(title: &str, profiles: &[Profile]) -> Chart {
    let (resistances, capacitances): (Vec<&Profile>, Vec<&Profile>) =
        profiles.iter().partition(|p| p.unit == "Ω");
    let panels = [resistances, capacitances]
        .into_iter()
        .filter(|of| !of.is_empty())
        .enumerate();
    Chart::new(
        title,
        "One quantity held, the others fitted again; what stays below a dashed line is not bounded",
        panels.map(|(k, of)| profile_panel(&of, k == 0)).collect(),
    )
}

fn profile_panel(profiles: &[&Profile], limits_named: bool) -> Panel {
    let limits = profiles.first().map_or((1.0, 3.84), |p| p.limits);
    let most = 1.5 * limits.1;
    let mut traces: Vec<Trace> = profiles
        .iter()
        .enumerate()
        .map(|(k, p)| Trace::new(&p.name, k, TraceStyle::Line, smooth_curve(p, most)))
        .collect();
    let xs = || traces.iter().flat_map(|t| &t.points).map(|p| p.0);
    let (low, high) = (xs().fold(1.0, f64::min), xs().fold(1.0, f64::max));
    for (label, limit) in [("68 %", limits.0), ("95 %", limits.1)] {
        traces.push(Trace::new(
            if limits_named { label } else { "" },
            6,
            TraceStyle::Dashed,
            vec![(low, limit), (high, limit)],
        ));
    }
    // Two names, for the panels have ranges of their own.
    let name = if limits_named {
        "Resistance / fitted value"
    } else {
        "Capacitance / fitted value"
    };
    let x = if high / low > 5.0 {
        AxisSpec::logarithmic(name)
    } else {
        AxisSpec::linear(name)
    };
    Panel::new(x, AxisSpec::linear("Δχ²").between(0.0, most), traces)
}

/// Interpolates the curve between its points linearly in the signed root of Δχ², as far as it is
/// inside the frame.
fn smooth_curve(profile: &Profile, most: f64) -> Vec<(f64, f64)> {
    const BETWEEN: i32 = 12;
    let signed = |p: &(f64, f64)| {
        (
            p.0 / profile.value,
            (p.0 - profile.value).signum() * p.1.sqrt(),
        )
    };
    let points: Vec<(f64, f64)> = profile.curve.iter().map(signed).collect();
    let between = |w: &[(f64, f64)]| {
        let (a, b) = (w[0], w[1]);
        (0..=BETWEEN)
            .map(move |k| f64::from(k) / f64::from(BETWEEN))
            .map(move |t| (a.0 + t * (b.0 - a.0), (a.1 + t * (b.1 - a.1)).powi(2)))
    };
    points
        .windows(2)
        .flat_map(between)
        .filter(|p| p.1 <= most)
        .collect()
}
