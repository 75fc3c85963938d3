//! Faults of agents, servers and the network between them: each job has exactly one run.

use crate::{
    between::{Between, Loses},
    files::Files,
    processes::{Broker, Served, poll, serve, start_agent, write_agent},
};

/// Asserts that these jobs, and no others, were run once each.
#[track_caller]
fn assert_run_once(files: &Files, jobs: &[String]) {
    let mut expected: Vec<String> = jobs.iter().map(|job| format!("demo-{job}")).collect();
    expected.sort();
    assert_eq!(files.runs(), expected);
    for run in &expected {
        assert_eq!(files.begins(run), 1, "{run}");
    }
}

fn wait_for_all(broker: &Broker, count: usize) {
    poll("the end of all jobs", || {
        (broker.fleet(&["status"])["jobs"]["done"] == count).then_some(())
    });
}

/// Waits until a job is started, or all are done.
fn wait_for_work(broker: &Broker, count: usize) {
    poll("a job that is started", || {
        let status = broker.fleet(&["status"]);
        let jobs = &status["jobs"];
        (jobs["started"] != 0 || jobs["done"] == count).then_some(())
    });
}

#[test]
fn a_server_that_is_killed_runs_each_job_once_while_its_agent_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let files = Files::tiny();
    let mut server = serve(&files);
    write_agent(&files, &broker, "north", &server.address);
    let _agent = start_agent(&files);
    broker.wait_for_bench("north", "idle");
    let jobs: Vec<String> = (0..5).map(|_| broker.submit(&files, &[])).collect();
    for _ in 0..3 {
        wait_for_work(&broker, 5);
        server.process.kill();
        server = serve(&files);
    }
    wait_for_all(&broker, 5);
    assert_run_once(&files, &jobs);
}

#[test]
fn an_agent_that_is_killed_at_any_moment_runs_each_job_once() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let files = Files::tiny();
    let server = serve(&files);
    write_agent(&files, &broker, "north", &server.address);
    let mut agent = start_agent(&files);
    broker.wait_for_bench("north", "idle");
    let jobs: Vec<String> = (0..5).map(|_| broker.submit(&files, &[])).collect();
    for _ in 0..4 {
        wait_for_work(&broker, 5);
        agent.process.kill();
        agent = start_agent(&files);
    }
    wait_for_all(&broker, 5);
    assert_run_once(&files, &jobs);
}

/// A job whose submission, or the answer to it, is lost, and an agent that is killed then.
fn killed_at_the_submission(loses: Loses) -> Option<()> {
    let folder = tempfile::tempdir().unwrap();
    let broker = Broker::start(folder.path().join("nats"))?;
    let files = Files::tiny();
    let server = serve(&files);
    let between = Between::to(&server.address);
    write_agent(&files, &broker, "north", &between.address);
    let mut agent = start_agent(&files);
    broker.wait_for_bench("north", "idle");
    between.lose(loses);
    let job = broker.submit(&files, &[]);
    poll("a submission", || (between.submissions() > 0).then_some(()));
    agent.process.kill();
    between.lose(Loses::Nothing);
    let is_begun = !files.runs().is_empty();
    assert!(
        loses != Loses::Submissions || !is_begun,
        "it was begun without a submission"
    );
    // The intent is on the disk of the agent, and the job is its own.
    let intents = std::fs::read_dir(files.path("agent/demo/intents")).unwrap();
    assert_eq!(intents.count(), 1);
    let _agent: Served = start_agent(&files);
    broker.wait_for(&job, "done");
    assert_run_once(&files, &[job]);
    Some(())
}

#[test]
fn an_agent_that_is_killed_between_check_and_begin_begins_once_when_it_is_back() {
    killed_at_the_submission(Loses::Submissions);
}

#[test]
fn an_agent_that_is_killed_before_it_hears_that_a_run_was_begun_does_not_begin_it_again() {
    killed_at_the_submission(Loses::Answers);
}

#[test]
fn an_agent_whose_answer_is_lost_asks_for_the_fate_before_it_submits_again() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let files = Files::tiny();
    let server = serve(&files);
    let between = Between::to(&server.address);
    write_agent(&files, &broker, "north", &between.address);
    let _agent = start_agent(&files);
    broker.wait_for_bench("north", "idle");
    between.lose(Loses::Answers);
    let job = broker.submit(&files, &[]);
    broker.wait_for(&job, "done");
    assert_run_once(&files, std::slice::from_ref(&job));
    // It never left this bench.
    let trail = files.text("data/audit.jsonl");
    let entries: Vec<&str> = trail
        .lines()
        .filter(|line| line.contains(&format!("fleet begin {job}")))
        .collect();
    assert!(
        entries.len() == 1 && entries[0].contains("\"outcome\":\"begun\""),
        "{trail}"
    );
    // The network is cut: no job is taken, and the bench is never shown as idle.
    between.lose(Loses::Everything);
    broker.wait_for_bench("north", "held");
    let waits = broker.submit(&files, &[]);
    assert_eq!(broker.job(&waits)["state"], "queued");
    between.lose(Loses::Nothing);
    broker.wait_for(&waits, "done");
}

#[test]
fn two_agents_on_one_folder_and_two_on_one_bench_never_run_a_job_twice() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let files = Files::tiny();
    let server = serve(&files);
    write_agent(&files, &broker, "north", &server.address);
    let _one = start_agent(&files);
    broker.wait_for_bench("north", "idle");
    let config = files.path("fleet.toml");
    let arguments = ["agent", config.to_str().unwrap()];
    let second = crate::processes::run(&crate::processes::fleet_program(), &arguments);
    let second = second.refused();
    assert!(
        second.contains("expected a data folder of its own"),
        "{second}"
    );
    // Another folder: it waits until the first one has been silent for the lease.
    let text = files
        .text("fleet.toml")
        .replace("data = \"agent\"", "data = \"other\"");
    files.write("fleet.toml", &text);
    let _two = start_agent(&files);
    let jobs: Vec<String> = (0..3).map(|_| broker.submit(&files, &[])).collect();
    wait_for_all(&broker, 3);
    assert_run_once(&files, &jobs);
    let intents = std::fs::read_dir(files.path("other/demo/intents")).unwrap();
    assert_eq!(intents.count(), 0);
}

#[test]
fn a_job_goes_back_after_the_lease_if_its_agent_is_gone_for_good_before_it_was_started() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let (files, others) = (Files::tiny(), Files::tiny().second());
    let server = serve(&files);
    let between = Between::to(&server.address);
    write_agent(&files, &broker, "north", &between.address);
    let mut agent = start_agent(&files);
    broker.wait_for_bench("north", "idle");
    between.lose(Loses::Submissions);
    let job = broker.submit(&files, &[]);
    poll("a submission", || (between.submissions() > 0).then_some(()));
    agent.process.kill();
    // Its run may have begun: no other bench begins it before a person puts it back.
    let other = serve(&others);
    write_agent(&others, &broker, "south", &other.address);
    let _south = start_agent(&others);
    broker.wait_for_bench("south", "idle");
    broker.wait_for(&job, "lost");
    broker.fleet(&["release", &job, "--why", "nothing runs there"]);
    let done = broker.wait_for(&job, "done");
    assert_eq!(done["bench"], "south/second");
    assert_eq!(others.runs(), [format!("demo-{job}-t2")]);
    // The first agent comes back, and does not begin it.
    between.lose(Loses::Nothing);
    let _agent = start_agent(&files);
    poll("an intent that is dropped", || {
        let intents = std::fs::read_dir(files.path("agent/demo/intents")).ok()?;
        (intents.count() == 0).then_some(())
    });
    assert_eq!(files.runs(), [""; 0]);
}
