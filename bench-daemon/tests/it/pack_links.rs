//! `eis-bench pack simulate --links`: the interconnect of a pack as a network.

use std::fs;

use serde_json::Value;

use crate::support::{program_in, project};

/// Two groups of two cells, fed at the first place; one link has a heat capacity.
const LINKS: &str = "# a comment\nfrom,to,ohm,heat_j_per_k\npack-,1.1-,0.001,0.5\n1.1-,1.2-,0.001,\n\
    1.1+,1.2+,0.001,\n1.1+,2.1-,0.001,\n1.2+,2.2-,0.001,\n2.1-,2.2-,0.001,\n2.1+,2.2+,0.001,\n\
    2.1+,pack+,0.001,\n";

/// Runs `pack simulate` with links in a new folder; returns it, the exit code and both texts.
fn play(links: &str, more: &[&str]) -> (tempfile::TempDir, (i32, String, String)) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("links.csv"), links).unwrap();
    let load = "time_s,current_a\n0,40\n1,0\n2,0\n";
    fs::write(folder.path().join("load.csv"), load).unwrap();
    let model = project("fixtures/data/cells/p45b_25C/model_4rc.json");
    let words = [
        "pack",
        "simulate",
        "--model",
        &model,
        "--profile",
        "load.csv",
        "--links",
    ];
    let pack = [
        "links.csv",
        "--series",
        "2",
        "--parallel",
        "2",
        "--ocv-v",
        "3.7",
        "--draws",
        "3",
    ];
    let words = [&words[..], &pack[..], more].concat();
    let met = program_in(folder.path(), &words).parts();
    (folder, met)
}

#[test]
fn the_links_share_the_current_and_their_loads_are_written() {
    let (folder, (code, text, error)) = play(LINKS, &["--json", "--out", "out"]);
    assert_eq!(code, 0, "{error}");
    let report: Value = serde_json::from_str(&text).unwrap();
    let links = &report["identical"]["links"];
    assert_eq!(links["largest_a"], 40.0);
    let first = &links["links"][0];
    assert!(
        (first["largest_a"].as_f64().unwrap() - 40.0).abs() < 1e-9,
        "{first}"
    );
    // 40 A through 1 mΩ for a second are 1.6 J.
    assert!(
        (first["heat_j"].as_f64().unwrap() - 1.6).abs() < 1e-6,
        "{first}"
    );
    assert!(
        (first["rise_k"].as_f64().unwrap() - 3.2).abs() < 1e-6,
        "{first}"
    );
    assert_eq!(links["links"][1].get("rise_k"), None);
    let path = links["hottest_path"].as_array().unwrap();
    assert_eq!(
        (&path[0], path.last().unwrap()),
        (&"pack-".into(), &"pack+".into())
    );
    assert!(report["identical"]["largest_share"].as_f64().unwrap() > 1.01);
    // Both feeding links, and less than all links in series.
    let equivalent = report["links_ohm"].as_f64().unwrap();
    assert!((0.002..0.004).contains(&equivalent), "{equivalent}");
    let table = fs::read_to_string(folder.path().join("out/links.csv")).unwrap();
    assert_eq!(table.lines().count(), 9);
    assert!(
        table.starts_with(
            "from,to,ohm,largest_a,heat_j,rise_k\npack-,1.1-,0.001,40.000000,1.600000,3.200000"
        ),
        "{table}"
    );

    let (_, (_, text, _)) = play(LINKS, &[]);
    assert!(text.contains("identical cells: 8 links, as "), "{text}");
    assert!(text.contains("pack- to 1.1-"), "{text}");
    assert!(text.contains("+ 3.20 K"), "{text}");
    assert!(
        text.contains("hottest path at 40.00 A: pack- 1.1- "),
        "{text}"
    );
}

#[test]
fn a_table_that_is_no_pack_is_refused_with_its_place() {
    let cases = [
        (
            "from,to\n",
            "line 1: expected a header with from, to, ohm, found \"from,to\"",
        ),
        (
            "from,to,ohm,wide\n",
            "line 1: expected the columns from, to, ohm, heat_j_per_k, found \"wide\"",
        ),
        (
            "from,to,ohm\npack-,1.1-,thick\n",
            "line 2: expected a number in ohm, found \"thick\"",
        ),
        (
            "from,to,ohm\npack-,3.1-,0.1\n",
            "line 2: expected a terminal of a cell from 1.1- to 2.2+, met 3.1-",
        ),
        (
            "from,to,ohm\npack-,1.1-,-1\n",
            "line 2: expected a resistance of 1e-7 Ω or more, met -1",
        ),
        (
            "from,to,ohm\npack-,1.1-,0.1\n",
            "links.csv: expected a link to pack+, met none",
        ),
    ];
    for (links, expected) in cases {
        let (_folder, (code, _, error)) = play(links, &[]);
        assert_eq!(code, 2, "{error}");
        assert!(error.contains(expected), "{error}");
    }
    let shorted = format!("{LINKS}1.2-,1.2+,0.001,\n");
    let (_folder, (code, _, error)) = play(&shorted, &[]);
    assert_eq!(code, 2);
    assert!(
        error.contains("expected no current without a load"),
        "{error}"
    );
}
