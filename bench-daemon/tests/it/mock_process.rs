//! The same experiment on simulated instruments in another process: only the addresses change.

use std::fs;

use analysis::dataset::read_spectrum_csv;
use bench_daemon::command::run::run_experiment;

use crate::support::{BENCH, EXPERIMENT, Files, MockProcess, program, sent, transcript, truth};

/// Scaled time. If the machine stalls for a whole second, twenty bench seconds pass, which is
/// tolerated.
const TIME: &str = "scaled:20";
const SEED: u64 = 1;

/// Four points, after a short reset and with the chiller on a serial line.
fn files() -> Files {
    Files::demo()
        .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"20 Hz\"")
        .edit(EXPERIMENT, "points = 20", "points = 4")
        .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]")
        .edit(EXPERIMENT, "setpoint = \"25 °C\"", "setpoint = \"22 °C\"")
        .edit(EXPERIMENT, "within = \"0.2 K\"", "within = \"1 K\"")
        .without(EXPERIMENT, "soc_reset")
}

/// Runs the experiment in this process and on the mocks of another, and compares.
fn compare(files: Files, over: &[&str], expected_addresses: &[(&str, &str)]) {
    let here = run_experiment(&files.load(), &files.path("here")).unwrap();
    let truth = truth(
        here.simulation.unwrap().world(),
        &here.measured.spectrum.points,
    );

    let files = files.edit(
        BENCH,
        "\"memory:chiller\"",
        "\"serial:/dev/ttyUSB0?baud=4800&parity=even&data=7&stop=1&flow=rtscts\"",
    );
    let written = files.path("benches/served.toml");
    let mock = MockProcess::start_over(&files.path(BENCH), &written, (TIME, SEED), over);
    assert_eq!(mock.line["time"], TIME);
    for (role, form) in expected_addresses {
        assert!(
            mock.address(role).starts_with(form),
            "{}",
            mock.address(role)
        );
    }
    let chiller = mock.address("chiller");
    assert!(
        chiller.starts_with("serial:/dev/pts/") && chiller.contains("baud=4800&parity=even"),
        "{chiller}"
    );
    let there = files.path("there");
    let experiment = files.experiment();
    let arguments = [
        "run".as_ref(),
        experiment.as_os_str(),
        "--bench".as_ref(),
        written.as_os_str(),
        "--out".as_ref(),
        there.as_os_str(),
    ];
    program(&arguments).expect_code(0);

    let found = read_spectrum_csv(&there.join("spectrum.csv")).unwrap();
    let expected = &here.measured.spectrum.points;
    assert_eq!(found.len(), 4);
    for ((found, expected), true_ohm) in found.iter().zip(expected).zip(truth) {
        assert_eq!(found.freq_hz, expected.freq_hz);
        let (error, off) = (found.z_ohm - expected.z_ohm, found.z_ohm - true_ohm);
        let sigma = |a: f64, b: f64| (a + b).sqrt();
        let (re, im) = (found.covariance.re_re, found.covariance.im_im);
        let sigma_re = sigma(re, expected.covariance.re_re);
        let sigma_im = sigma(im, expected.covariance.im_im);
        assert!(
            error.re.abs() < 5.0 * sigma_re && error.im.abs() < 5.0 * sigma_im,
            "{} Hz: {found:?}, {expected:?}",
            found.freq_hz
        );
        assert!(
            off.re.abs() < 5.0 * re.sqrt() && off.im.abs() < 5.0 * im.sqrt(),
            "{} Hz: {found:?}, {true_ohm}",
            found.freq_hz
        );
        // An uncertainty that is large enough proves everything.
        assert!(
            re.sqrt().max(im.sqrt()) < 0.005 * true_ohm.norm(),
            "{found:?}"
        );
    }
    for role in [
        "supply4q",
        "generator",
        "scope",
        "load",
        "supply",
        "chiller",
        "logger",
        "jig",
    ] {
        let records = transcript(&there, role).records;
        let first = records[0].to_string();
        let address = mock.address(role);
        assert!(first.contains(&address), "{first}: expected {address}");
        assert!(!sent(&there, role).is_empty(), "{role}");
    }
    assert!(
        sent(&there, "chiller").contains(&"OUT_SP_00 22.00".to_owned()),
        "{:?}",
        sent(&there, "chiller")
    );
}

#[test]
#[ignore = "drill"]
fn only_the_addresses_change_from_this_process_to_another() {
    compare(files(), &[], &[("scope", "tcp://127.0.0.1:")]);
}

#[test]
#[ignore = "drill"]
fn a_bench_whose_instruments_are_on_as_many_transports_measures_the_same() {
    let over = [
        "supply4q=vxi11",
        "generator=gpib",
        "scope=hislip",
        "load=vxi11-mapped",
        "supply=hislip",
        "logger=vxi11",
    ];
    let forms = [
        ("supply4q", "vxi11:127.0.0.1:"),
        ("generator", "gpib:tcp:127.0.0.1:"),
        ("scope", "hislip:127.0.0.1:"),
        ("load", "vxi11:127.0.0.1/inst0?portmapper="),
        ("supply", "hislip:127.0.0.1:"),
        ("logger", "vxi11:127.0.0.1:"),
        ("jig", "tcp://127.0.0.1:"),
    ];
    compare(files(), &over, &forms);
}

#[test]
fn another_transport_is_for_a_role_of_the_bench_and_is_one_that_there_is() {
    let files = Files::short(2);
    let bench = files.path(BENCH);
    for (over, expected) in [
        (
            "printer=tcp",
            "--over: expected a role of this bench (supply4q, generator, ",
        ),
        (
            "scope=usb",
            "expected TRANSPORT or ROLE=TRANSPORT out of tcp, vxi11, vxi11-mapped, hislip, gpib, \
            serial, found `scope=usb`",
        ),
    ] {
        let ended = program(&[
            "mock".as_ref(),
            bench.as_os_str(),
            "--over".as_ref(),
            over.as_ref(),
        ]);
        ended.expect_code(2);
        assert!(ended.stderr.contains(expected), "{}", ended.stderr);
    }
}

#[test]
fn a_wrong_model_at_an_address_is_named_and_only_asked_who_it_is() {
    for (role, other, expected, found) in [
        (
            "generator",
            "scope",
            "generator: expected a siglent-sdg1000x, found \"Siglent Technologies,SDS",
            "SDS",
        ),
        (
            "load",
            "supply4q",
            "supply4q: expected a kepco-bop-mg, found \"Siglent Technologies,SDL",
            "SDL",
        ),
    ] {
        let files = Files::short(2);
        let written = files.path("benches/served.toml");
        let mock = MockProcess::start(&files.path(BENCH), &written, (TIME, SEED));
        let text = fs::read_to_string(&written).unwrap();
        let (here, there) = (mock.address(role), mock.address(other));
        let swapped = text
            .replace(&here, "elsewhere")
            .replace(&there, &here)
            .replace("elsewhere", &there);
        assert_ne!(swapped, text);
        fs::write(&written, swapped).unwrap();
        let (experiment, out) = (files.experiment(), files.path("run"));
        let arguments = [
            "run".as_ref(),
            experiment.as_os_str(),
            "--bench".as_ref(),
            written.as_os_str(),
            "--out".as_ref(),
            out.as_os_str(),
        ];
        let ended = program(&arguments);
        ended.expect_code(3);
        let message = ended.message();
        assert!(
            message.starts_with(expected)
                && message.contains(found)
                && message.contains("bench file"),
            "{message}"
        );
        assert!(message.contains("at tcp://127.0.0.1:"), "{message}");
        for asked in [
            "supply4q",
            "generator",
            "scope",
            "load",
            "supply",
            "chiller",
            "logger",
            "jig",
        ] {
            for message in sent(&out, asked) {
                assert!(
                    ["*IDN?", "VERSION"].contains(&message.as_str()),
                    "{asked} was sent {message:?}"
                );
            }
        }
        let identified = program(&["identify".as_ref(), written.as_os_str()]);
        identified.expect_code(3);
        assert_eq!(
            identified
                .stdout
                .matches("NOT THE CONFIGURED MODEL")
                .count(),
            2,
            "{}",
            identified.stdout
        );
    }
}

#[test]
fn mocks_do_not_write_over_the_bench_file_that_they_are_of() {
    let files = Files::short(2);
    let bench = files.path(BENCH);
    let before = fs::read(&bench).unwrap();
    let ended = program(&[
        "mock".as_ref(),
        bench.as_os_str(),
        "--write-bench".as_ref(),
        bench.as_os_str(),
    ]);
    ended.expect_code(2);
    assert!(
        ended
            .message()
            .contains("expected another file than the bench file itself, which would be lost"),
        "{}",
        ended.message()
    );
    assert_eq!(fs::read(&bench).unwrap(), before);
}
