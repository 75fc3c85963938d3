//! Soak test of many benches and one broker with all kinds of faults: each job must run once,
//! according to the ledgers of the benches. Needs `nats-server` in the PATH, and reports if it is
//! missing.
use std::{path::Path, sync::Arc};

use crate::support::{
    Broker, Daemon, Machine, Network, client, clock, pause, resident_mb, settings, witness, work,
};
use bench_fleet::{FleetSettings, JobState, client::Looking, view::JobFilter};

/// Numbers of a soak test.
#[derive(Clone, Copy)]
struct Drill {
    daemons: usize,
    benches_each: usize,
    jobs: usize,
    run_s: f64,
    lease_s: f64,
    broker_kills: usize,
    /// Time between two kills of the broker, s, and time that it is away.
    broker_every_s: f64,
    broker_away_s: f64,
    daemon_kills: usize,
    /// Number of daemons whose machines are switched off with them and never return.
    machines_off: usize,
    /// A third of the daemons is cut off for so long, s; 0 for none.
    cut_s: f64,
    /// Number of daemons through which a user watches the fleet, as the page does.
    looked_at: usize,
}

/// Counts of a drill.
#[derive(Default)]
struct Tally {
    broker_kills: usize,
    daemon_kills: usize,
    machines_off: usize,
    cut: usize,
    released: usize,
}

struct Stage {
    broker: Broker,
    network: Network,
    daemons: Vec<Daemon>,
    machines: Vec<Arc<Machine>>,
    settings: FleetSettings,
    tally: Tally,
}

impl Stage {
    async fn build(folder: &Path, drill: &Drill) -> Option<Self> {
        let broker = Broker::start(folder)?;
        let network = Network::to(broker.port).await;
        let direct = settings(broker.address(), drill.lease_s);
        let beyond = settings(network.address(), drill.lease_s);
        // Waits until the broker is ready.
        drop(client(&direct).await);
        let (mut daemons, mut machines) = (Vec::new(), Vec::new());
        for number in 0..drill.daemons {
            let names = (0..drill.benches_each).map(|bench| format!("d{number:03}b{bench}"));
            let own: Vec<_> = names
                .map(|name| Machine::new(folder, &name, drill.run_s))
                .collect();
            machines.extend(own.iter().cloned());
            let settings = if number % 3 == 0 { &beyond } else { &direct };
            daemons.push(Daemon::new(folder, settings, own));
        }
        Some(Self {
            broker,
            network,
            daemons,
            machines,
            settings: direct,
            tally: Tally::default(),
        })
    }

    /// Starts to watch the fleet.
    async fn looking(&self) -> Looking {
        let client = client(&self.settings).await;
        loop {
            if let Ok(looking) = client.seer("lab").await {
                return looking;
            }
        }
    }

    /// Simulates users that have the page open at some daemons.
    fn look_at(&self, count: usize) -> tokio::task::JoinSet<()> {
        let mut pages = tokio::task::JoinSet::new();
        for fleet in self
            .daemons
            .iter()
            .filter_map(|daemon| daemon.fleet.clone())
            .take(count)
        {
            pages.spawn(async move {
                loop {
                    let seer = fleet.seer().await;
                    let _ = seer.map(|seer| (seer.view(), seer.jobs(&JobFilter::default())));
                    pause(2.0).await;
                }
            });
        }
        pages
    }

    async fn break_things(&mut self, drill: &Drill) {
        let rounds = drill.broker_kills.max(1);
        let kills_each = drill.daemon_kills.div_ceil(rounds);
        let clock = clock();
        let mut cut_since = None;
        for round in 0..rounds {
            if drill.cut_s > 0.0 && round == rounds / 4 {
                self.network.cut(true);
                self.tally.cut = drill.daemons.div_ceil(3);
                cut_since = Some(clock.now_s());
            }
            if cut_since.is_some_and(|since_s| clock.now_s() - since_s > drill.cut_s) {
                self.network.cut(false);
                cut_since = None;
            }
            self.kill_daemons(drill, kills_each).await;
            if self.tally.broker_kills < drill.broker_kills {
                self.broker.kill();
                pause(drill.broker_away_s).await;
                self.broker.restart();
                self.tally.broker_kills += 1;
            }
            pause(drill.broker_every_s).await;
        }
        while cut_since.is_some_and(|since_s| clock.now_s() - since_s < drill.cut_s) {
            pause(0.5).await;
        }
        self.network.cut(false);
    }

    /// Kills some daemons, and restarts those that were killed in the previous round.
    async fn kill_daemons(&mut self, drill: &Drill, count: usize) {
        for daemon in &mut self.daemons {
            let is_off = daemon.machines[0].capabilities.current_a < 0.0;
            if daemon.fleet.is_none() && !is_off {
                daemon.start();
            }
        }
        for _ in 0..count.min(drill.daemon_kills - self.tally.daemon_kills) {
            // Distributed over all daemons.
            let index = self.tally.daemon_kills * 7 % self.daemons.len();
            self.daemons[index].kill();
            self.tally.daemon_kills += 1;
        }
        pause(0.2).await;
    }

    fn revive(&mut self) {
        for daemon in &mut self.daemons {
            if daemon.fleet.is_none() {
                daemon.start();
            }
        }
    }

    /// Machines that go off with what they do, for ever.
    fn lose_machines(&mut self, count: usize) {
        for _ in 0..count {
            let mut daemon = self.daemons.pop().unwrap();
            daemon.kill();
            for machine in &daemon.machines {
                machine.power_off();
            }
            self.tally.machines_off += 1;
        }
    }

    /// Jobs that are not done.
    async fn unfinished(&self) -> Vec<bench_fleet::Job> {
        let looking = client(&self.settings).await.seer("lab").await.unwrap();
        let filter = JobFilter {
            most: 1000,
            ..JobFilter::default()
        };
        let jobs = looking.seer.jobs(&filter).jobs.into_iter();
        let open = jobs.filter(|view| view.job.state != JobState::Done);
        open.map(|view| view.job).collect()
    }

    /// Puts lost jobs back, as a person would after an inspection; returns the jobs.
    async fn release_lost(&mut self) -> Vec<String> {
        let client = client(&self.settings).await;
        let looking = client.seer("lab").await.unwrap();
        // What silence is must be seen for the lease time.
        pause(2.0 * self.settings.lease_s).await;
        let filter = JobFilter {
            state: Some("lost".to_owned()),
            most: 1000,
            ..JobFilter::default()
        };
        let mut released = Vec::new();
        for view in looking.seer.jobs(&filter).jobs {
            let job = view.job.job;
            let why = "its machine is off";
            if client.release_job(&job, "ann", why).await.is_ok() {
                released.push(job);
            }
        }
        self.tally.released += released.len();
        released
    }
}

/// Runs a soak test, and checks the ledgers of the benches.
async fn play(drill: Drill) {
    let folder = tempfile::tempdir().unwrap();
    let Some(mut stage) = Stage::build(folder.path(), &drill).await else {
        return;
    };
    let clock = clock();
    let people = client(&stage.settings).await;
    let _pages = stage.look_at(drill.looked_at);
    let (messages, submitted_s) = (stage.broker.messages(), clock.now_s());
    let jobs = people.submit(&work("work", drill.jobs)).await.unwrap();
    if drill.machines_off > 0 {
        pause(drill.run_s / 2.0).await;
        stage.lose_machines(drill.machines_off);
    }
    stage.break_things(&drill).await;
    stage.revive();
    let released = if drill.machines_off > 0 {
        stage.release_lost().await
    } else {
        Vec::new()
    };
    let rounds = (drill.jobs as f64 / stage.machines.len() as f64).ceil();
    let patience_s = 120.0 + 4.0 * rounds * (drill.run_s + 1.0);
    let looking = stage.looking().await;
    let all_done = async || {
        pause(0.5).await;
        looking.seer.view().jobs.of(JobState::Done) == drill.jobs
    };
    let began_s = clock.now_s();
    while !all_done().await {
        let waited_s = clock.now_s() - began_s;
        assert!(waited_s < patience_s, "{:#?}", stage.unfinished().await);
    }
    let took_s = clock.now_s() - submitted_s;
    let seen = witness(&stage.machines, "work");
    let times = |wanted: usize| {
        seen.begins
            .values()
            .filter(|times| **times == wanted)
            .count()
    };
    let twice: Vec<_> = seen
        .begins
        .iter()
        .filter(|(job, times)| **times > 1 && !released.contains(job))
        .collect();
    let never = jobs.iter().filter(|job| !seen.begins.contains_key(*job));
    let rows = [
        ("benches", stage.machines.len().to_string()),
        ("daemons", drill.daemons.to_string()),
        ("jobs", drill.jobs.to_string()),
        (
            "broker killed and restarted",
            stage.tally.broker_kills.to_string(),
        ),
        ("daemons killed", stage.tally.daemon_kills.to_string()),
        (
            "daemons cut off",
            format!("{} for {} s", stage.tally.cut, drill.cut_s),
        ),
        (
            "machines lost for ever",
            stage.tally.machines_off.to_string(),
        ),
        (
            "started runs put back by a person",
            stage.tally.released.to_string(),
        ),
        ("daemons that are looked at", drill.looked_at.to_string()),
        ("begun once", times(1).to_string()),
        ("begun twice without a person", twice.len().to_string()),
        ("never begun", never.clone().count().to_string()),
        ("ended", seen.ends.to_string()),
        ("benches driven by two", seen.driven_by_two.to_string()),
        ("time", format!("{took_s:.0} s")),
        ("messages of the broker", {
            let now = stage.broker.messages();
            match drill.broker_kills {
                0 => format!("{:.0} per s", (now - messages) as f64 / took_s),
                _ => "not counted over its kills".to_owned(),
            }
        }),
        (
            "memory of the broker",
            format!("{:.0} MB", stage.broker.memory_mb()),
        ),
        (
            "memory of all daemons",
            format!("{:.0} MB", resident_mb("/proc/self/status")),
        ),
    ];
    for (what, value) in rows {
        println!("{what:<36} {value:>12}");
    }
    assert!(twice.is_empty(), "{twice:?}");
    assert_eq!(never.count(), 0);
    assert_eq!(seen.driven_by_two, 0);
    // A machine can be lost after the end of its run and before that was reported. A person who
    // puts the job back makes it run a second time, and both runs end.
    let most = drill.jobs + stage.tally.released;
    assert!((drill.jobs..=most).contains(&seen.ends), "{}", seen.ends);
    assert_eq!(seen.begins.len(), drill.jobs);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_job_runs_once_whatever_breaks() {
    play(Drill {
        daemons: 20,
        benches_each: 1,
        jobs: 100,
        run_s: 0.5,
        lease_s: 2.0,
        broker_kills: 2,
        broker_every_s: 1.5,
        broker_away_s: 0.3,
        daemon_kills: 5,
        machines_off: 1,
        cut_s: 3.0,
        looked_at: 0,
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "long drill"]
async fn two_hundred_benches_run_two_thousand_jobs() {
    play(Drill {
        daemons: 100,
        benches_each: 2,
        jobs: 2000,
        run_s: 5.0,
        lease_s: 6.0,
        broker_kills: 0,
        broker_every_s: 0.0,
        broker_away_s: 0.0,
        daemon_kills: 0,
        machines_off: 0,
        cut_s: 0.0,
        looked_at: 5,
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "long drill"]
async fn two_hundred_benches_run_two_thousand_jobs_once_whatever_breaks() {
    play(Drill {
        daemons: 100,
        benches_each: 2,
        jobs: 2000,
        run_s: 25.0,
        lease_s: 6.0,
        broker_kills: 20,
        broker_every_s: 12.0,
        broker_away_s: 2.0,
        daemon_kills: 50,
        machines_off: 3,
        cut_s: 150.0,
        looked_at: 0,
    })
    .await;
}
