//! `eis-bench doctor`: a bench examined before its first use, with a report that a person signs.

use crate::command::printed::say_json;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum};
use instruments::{
    clock::{self, Clock, TimeMode},
    fixture::Fixture,
    transport::MemoryHub,
};

use bench_core::{
    bench::survey::AnyInstrument,
    bench::{Bench, Connections},
    operator::progress::Progress,
    operator::{Operator, on_terminal, question::Question},
    safety::bench_lease::BenchLease,
    safety::failure::Failure,
    safety::guardian::{Charge, GuardianError},
    safety::state::{Lock, State},
    sim::Simulation,
    watch::unwatched,
};
use bench_evaluate::{
    doctor::{
        self, COPPER_WINDOW_V, Check, Examination, Findings, Instrument, Outcome, REPORT, Report,
        Texts, Verdict,
    },
    run::{StopSignals, caught, ensure_outputs_off},
};
use bench_plan::{
    config::{self, Source, load_any_bench},
    plan::{Plan, fixture_name},
    support::{
        account, hash,
        terminal::{remark, say},
    },
};

/// Arguments of `doctor`.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// The bench file, or an experiment on it.
    pub config: PathBuf,
    /// The control that is clamped into the jig instead of the cell. Without one nothing is
    /// energised, and the report is incomplete.
    #[arg(long, value_name = "FIXTURE")]
    pub fixture: Option<Control>,
    /// Confirm that the fixture is in the jig and the cell is not.
    #[arg(long)]
    pub yes: bool,
    /// Who signs the report [default: the account's name]
    #[arg(long, value_name = "NAME")]
    pub operator: Option<String>,
    /// Folder of the report [default: doctor/BENCH-DATE]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
    /// Take the bench, switch its output on at zero current, and hang, to test the guardian.
    #[arg(long, hide = true)]
    pub hang: bool,
}

/// A control that replaces the cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum Control {
    /// Both probe pairs on the current shunt.
    Shunt,
    /// The copper fake cell in the jig, C3 and C4 on its Kelvin contacts.
    FakeCell,
}

impl Control {
    fn fixture(self) -> Fixture {
        match self {
            Self::Shunt => Fixture::Shunt,
            Self::FakeCell => Fixture::FakeCell,
        }
    }
}

/// Examines a bench and writes the report.
///
/// # Errors
/// A mistake in the files; a bench that is in use; [`Failure::Doctor`] if a check failed;
/// [`Failure::Unsafe`].
pub fn doctor(args: &DoctorArgs) -> Result<(), Failure> {
    let config = load_any_bench(&args.config)?;
    let source = Source::read(&config.path)?;
    let fixture = args.fixture.map(Control::fixture);
    let unix_s = clock::unix_time_s();
    let folder = args
        .out
        .clone()
        .unwrap_or_else(|| folder(&config.name, unix_s));
    let mode = if config.in_process() {
        TimeMode::Virtual
    } else {
        config.time()
    };
    let runtime = Clock::runtime(mode)?;
    if args.hang {
        let sha256 = hash::sha256(source.text());
        return runtime
            .block_on(async { doctor::hold(&config, sha256, &Clock::start(mode), &folder).await });
    }
    if config.wiring.analog.is_some() && fixture.is_some() {
        return Err(Failure::Usage(
            "expected no --fixture: the bipolar supply is analog, without a link, and the doctor \
            applies no current through it; each power-up of a run tests its gain and its sign"
                .to_owned(),
        ));
    }
    confirmed(&config, args)?;
    if fixture == Some(Fixture::FakeCell) && config.fake_cell.is_none() {
        return Err(Failure::Usage(
            "expected a section [controls.fake_cell] in the bench file, which says what it is"
                .to_owned(),
        ));
    }
    let (findings, instruments) = runtime.block_on(async {
        let clock = Clock::start(mode);
        Box::pin(
            Visit {
                config: &config,
                clock,
                fixture,
                folder: &folder,
                text: source.text(),
                yes: args.yes,
            }
            .go(),
        )
        .await
    })?;
    let outcome = outcome(&findings, fixture);
    let report = Report {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        bench: config.name.clone(),
        config_sha256: hash::sha256(source.text()),
        operator: args.operator.clone().unwrap_or_else(account::who),
        date: bench_evaluate::support::present::utc(unix_s),
        unix_s,
        fixture: fixture.map(|fixture| fixture_name(fixture).to_owned()),
        instruments,
        outcome,
        checks: findings.checks,
        sha256: String::new(),
    }
    .sealed();
    unwatched(&config).iter().for_each(|line| remark!("{line}"));
    doctor::write(&report, &folder)?;
    keep(&report, &config)?;
    tell(&report, &folder, args.json)
}

/// Stores the report for later runs. A report that ended with the checks of the machine contains
/// nothing about the bench, so the previous report stays.
fn keep(report: &Report, config: &config::Bench) -> Result<(), Failure> {
    let Some(state) = State::of(config)? else {
        return Ok(());
    };
    if report.instruments.is_empty() {
        remark!("no instrument was asked: what the doctor has found of this bench before stands");
        return Ok(());
    }
    Ok(state.json(REPORT, report)?)
}

/// Requires a confirmation before current flows.
fn confirmed(config: &config::Bench, args: &DoctorArgs) -> Result<(), Failure> {
    let device = matches!(config.instruments.jig, Some(config::Jig::Device(_)));
    if args.fixture.is_none() || args.yes || device || Operator::detect() == Operator::Terminal {
        return Ok(());
    }
    let text = "expected a person at a terminal who confirms the fixture, or --yes: half an ampere \
    is going to flow through what is in the jig";
    Err(Failure::Usage(text.to_owned()))
}

fn folder(bench: &str, unix_s: f64) -> PathBuf {
    let plain: String = bench_evaluate::support::present::utc(unix_s)
        .chars()
        .filter(|c| c.is_ascii_digit() || *c == 'T')
        .collect();
    let name: String = bench
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') {
                c
            } else {
                '_'
            }
        })
        .collect();
    PathBuf::from("doctor").join(format!("{name}-{plain}"))
}

fn outcome(findings: &Findings, fixture: Option<Fixture>) -> Outcome {
    match (findings.count(Verdict::Fail), fixture) {
        (0, Some(_)) => Outcome::Passed,
        (0, None) => Outcome::Incomplete,
        _ => Outcome::Failed,
    }
}

fn tell(report: &Report, folder: &Path, json: bool) -> Result<(), Failure> {
    if json {
        say_json(report)?;
    } else {
        for Check {
            id,
            expected,
            met,
            verdict,
            advice,
        } in &report.checks
        {
            let expected = if expected.is_empty() || *verdict == Verdict::Ok {
                String::new()
            } else {
                format!("; expected {expected}")
            };
            say!("{:<8} {id:<22} {met}{expected}", verdict.label());
            if !advice.is_empty() {
                say!("{:<8} {:<22} → {advice}", "", "");
            }
        }
        say!("report: {}", folder.join("doctor.html").display());
    }
    let failed: Vec<&str> = report
        .checks
        .iter()
        .filter(|check| check.verdict == Verdict::Fail)
        .map(|check| check.id.as_str())
        .collect();
    if failed.is_empty() {
        Ok(())
    } else {
        Err(Failure::Doctor(failed.join(", ")))
    }
}

/// The checks of the guardian.
const GUARDIAN: [&str; 2] = ["guardian.start", "guardian.lease"];

/// Marks the checks as skipped that are not performed after a failed one.
fn not_after<'a>(findings: &mut Findings, ids: impl IntoIterator<Item = &'a str>) {
    let why = format!("not after {}", findings.stopped().unwrap_or_default());
    findings.skip(&ids.into_iter().collect::<Vec<_>>(), &why, "");
}

struct Visit<'a> {
    config: &'a config::Bench,
    clock: Clock,
    fixture: Option<Fixture>,
    folder: &'a Path,
    text: &'a str,
    yes: bool,
}

impl Visit<'_> {
    async fn go(self) -> Result<(Findings, Vec<Instrument>), Failure> {
        doctor::free(self.config, &self.clock).await?;
        let mut findings = Findings::default();
        doctor::machine(&mut findings, self.config, &self.clock, self.folder).await;
        if findings.stopped().is_some() {
            self.unasked(&mut findings);
            return Ok((findings, Vec::new()));
        }
        let lock = self.lock()?;
        let hub = MemoryHub::new();
        let simulation = self
            .config
            .simulation
            .as_ref()
            .filter(|_| self.config.in_process());
        let simulation = simulation
            .map(|section| Simulation::new(&section.scenario, 0))
            .transpose()?;
        if let Some(simulation) = &simulation {
            simulation.serve_in_process(self.config, &self.clock, &hub)?;
        }
        let connections = Connections {
            clock: self.clock.clone(),
            hub,
            taps: BTreeMap::new(),
        };
        let instruments = self.reach(&mut findings, &connections).await;
        // The lease takes it again, with a guardian beside it.
        drop(lock);
        if findings.stopped().is_some() {
            not_after(&mut findings, doctor::LIVE.into_iter().chain(GUARDIAN));
            return Ok((findings, instruments));
        }
        let mut findings = self.guarded(findings, &connections).await?;
        match self.fixture {
            _ if self.config.in_process() => findings.skip(
                &["guardian.lease"],
                "the bench is simulated in this process",
                "",
            ),
            Some(fixture) if findings.stopped().is_none() => {
                doctor::lease(
                    &mut findings,
                    self.config,
                    &self.clock,
                    self.folder,
                    fixture,
                )
                .await;
            }
            Some(_) => not_after(&mut findings, ["guardian.lease"]),
            None => findings.skip(
                &["guardian.lease"],
                "no fixture in the jig",
                "give --fixture",
            ),
        }
        Ok((findings, instruments))
    }

    /// Marks the instrument checks as not performed: the bench is latched, or its report could
    /// not be written.
    fn unasked(&self, findings: &mut Findings) {
        let reach: Vec<String> = self
            .config
            .instruments
            .addressed()
            .iter()
            .map(|(role, _)| format!("reach.{role}"))
            .collect();
        not_after(
            findings,
            reach
                .iter()
                .map(String::as_str)
                .chain(doctor::LIVE)
                .chain(GUARDIAN),
        );
    }

    /// Locks the bench, so that no run starts while the instruments are queried.
    fn lock(&self) -> Result<Option<Lock>, Failure> {
        let Some(state) = State::of(self.config)? else {
            return Ok(None);
        };
        Ok(Some(state.lock(&std::path::absolute(self.folder)?)?))
    }

    /// Queries each instrument separately, so that a silent one does not hide the others.
    async fn reach(&self, findings: &mut Findings, connections: &Connections) -> Vec<Instrument> {
        let mut found = Vec::new();
        for (role, instrument) in self.config.instruments.addressed() {
            let one = config::Bench {
                instruments: self.config.instruments.only(role),
                ..self.config.clone()
            };
            let answer = match Bench::open(&one, connections).await.map(AnyInstrument::of) {
                Ok(mut any) => match any.first_mut() {
                    Some((_, any)) => any.describe().await.map_err(|error| error.to_string()),
                    None => Err("no dialect".to_owned()),
                },
                Err(error) => Err(error.to_string()),
            };
            if !doctor::reached(
                findings,
                role,
                answer.as_ref().map_err(Clone::clone),
                &instrument.model,
            ) {
                findings.stop();
            }
            let identity = answer.map_or_else(|_| String::new(), |answer| answer.identity.raw);
            let (model, address) = (instrument.model.clone(), instrument.address.to_string());
            found.push(Instrument {
                role: role.to_owned(),
                model,
                address,
                identity,
            });
        }
        for role in ["supply4q", "generator", "scope"] {
            if !found.iter().any(|instrument| instrument.role == role) && self.fixture.is_some() {
                findings.judge(
                    &format!("reach.{role}"),
                    Texts {
                        expected: "one on the bench",
                        met: "none",
                    },
                    false,
                    "without it nothing can be proven",
                );
                findings.stop();
            }
        }
        found
    }

    /// Runs the checks that need the bench for themselves, with a guardian beside them. Always ends
    /// in safe state.
    async fn guarded(
        &self,
        mut findings: Findings,
        connections: &Connections,
    ) -> Result<Findings, Failure> {
        let progress = Progress::new(&Plan { stages: Vec::new() });
        let charge = Charge {
            bench: self.config,
            run: self.folder,
            window_v: COPPER_WINDOW_V,
            cell_degc: None,
            sha256: hash::sha256(self.text),
        };
        let mut stop = StopSignals::install()?;
        let expected = "a guardian that reaches every instrument that can move charge";
        let taken = tokio::select! {
            taken = BenchLease::take_for(&charge, [&self.clock, &self.clock], progress.doing()) => taken,
            () = stop.requested() => return Err(Failure::Interrupted(self.folder.display().to_string())),
        };
        let mut lease = match taken {
            Ok(lease) => {
                if self.config.in_process() {
                    findings.skip(
                        &["guardian.start"],
                        "the bench is simulated in this process",
                        "",
                    );
                } else {
                    findings.judge(
                        "guardian.start",
                        Texts {
                            expected,
                            met: "it is there",
                        },
                        true,
                        "",
                    );
                }
                lease
            }
            // The bench is in use, or a person must inspect it first. The report does not record
            // this as a fault.
            Err(failure @ (Failure::State(_) | Failure::Guardian(GuardianError::Busy(_)))) => {
                return Err(failure);
            }
            Err(failure) => {
                findings.judge(
                    "guardian.start",
                    Texts {
                        expected,
                        met: failure.to_string(),
                    },
                    false,
                    "nothing may be energised without it",
                );
                findings.stop();
                findings.skip(&doctor::LIVE, "not after guardian.start", "");
                return Ok(findings);
            }
        };
        let mut bench = match Bench::open(self.config, connections).await {
            Ok(bench) => bench,
            Err(error) => return lease.end(Err(error.into()), None).await,
        };
        // Nothing was changed yet, and what another program has switched on is not the doctor's to
        // switch off.
        if let Err(failure) = ensure_outputs_off(&mut bench).await {
            return lease.end(Err(failure), bench.close()).await;
        }
        let mut examination = Examination::new(self.config, self.clock.clone(), bench, findings);
        let examined = tokio::select! {
            examined = caught(self.examine(&mut examination)) => examined,
            () = stop.requested() => Err(Failure::Interrupted(self.folder.display().to_string())),
            lost = lease.lost() => Err(lost.into()),
        };
        let safe = examination.bench.made_safe().await;
        let Examination {
            bench,
            mut findings,
            ..
        } = examination;
        let read = bench.close();
        if safe.is_ok() {
            let met = match (&read, self.config.wiring.analog) {
                (Some(report), Some(_)) => report.message.as_str(),
                _ => "it is so",
            };
            findings.add(
                "safe.end",
                Texts {
                    expected: "every output off and read back, no current",
                    met,
                },
                Verdict::Ok,
                "",
            );
        }
        lease
            .end(Failure::unsafe_first(safe, examined), read)
            .await
            .map(|()| findings)
    }

    async fn examine(&self, examination: &mut Examination<'_>) -> Result<(), Failure> {
        if let Some(fixture) = self.fixture {
            self.mount(examination, fixture).await?;
        }
        examination
            .examine(
                self.fixture,
                if self.config.wiring.analog.is_some() {
                    "the bipolar supply is analog, without a link: each power-up of a run tests it"
                } else {
                    "no fixture in the jig: --fixture fake_cell, or shunt, proves it"
                },
            )
            .await;
        Ok(())
    }

    /// Safe state comes first: the jig must not be live when a person reaches into it.
    async fn mount(
        &self,
        examination: &mut Examination<'_>,
        fixture: Fixture,
    ) -> Result<(), Failure> {
        examination.bench.made_safe().await?;
        examination.bench.off_again().await?;
        let error = examination.bench.error("jig");
        if let Some(jig) = examination.bench.instruments.jig.as_mut() {
            return Ok(jig.mount(fixture).await.map_err(error)?);
        }
        if self.yes {
            remark!(
                "taken on your word: {} in the jig, no cell",
                fixture_name(fixture)
            );
            return Ok(());
        }
        let _person = self.clock.wait(None);
        Ok(on_terminal(&Question::new(fixture, None, ""))
            .await
            .map_err(bench_core::executor::ExecuteError::from)?)
    }
}
