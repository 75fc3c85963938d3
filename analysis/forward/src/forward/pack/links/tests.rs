use super::super::scatter::{Draws, Outcome, ScatterSetup, Spread, scatter};
use super::super::thermal::PackThermal;
use super::*;
use crate::forward::{CellWindow, Demand, Interpolation, OcvSource, Profile};
use analysis_model::{
    model::{Erm, RcBranch},
    pack::Pack,
};

fn link(from: &str, to: &str, r_ohm: f64) -> Link {
    Link {
        from: from.to_owned(),
        to: to.to_owned(),
        r_ohm,
        heat_j_per_k: None,
    }
}

fn links(rows: &[(&str, &str, f64)]) -> Vec<Link> {
    let rows = rows.iter();
    rows.map(|(from, to, r_ohm)| link(from, to, *r_ohm))
        .collect()
}

/// A sheet joins the cells of both groups that it touches; the pack is fed at the first place.
fn sheets(series: u32, parallel: u32, r_ohm: f64) -> Vec<Link> {
    let mut out = Vec::new();
    for place in 1..=parallel {
        for group in 1..series {
            let (plus, minus) = (
                format!("{group}.{place}+"),
                format!("{}.{place}-", group + 1),
            );
            out.push(link(&plus, &minus, r_ohm));
        }
        if place > 1 {
            for group in 1..=series {
                for sign in ["-", "+"] {
                    let (a, b) = (place - 1, place);
                    out.push(link(
                        &format!("{group}.{a}{sign}"),
                        &format!("{group}.{b}{sign}"),
                        r_ohm,
                    ));
                }
            }
        }
    }
    out.push(link("pack-", "1.1-", r_ohm));
    out.push(link(&format!("{series}.1+"), "pack+", r_ohm));
    out
}

/// A jump of power through equal cells.
fn run(pack: Pack, links: Option<&Links>, tab_ohm: f64) -> Outcome {
    let cell = Erm {
        r_ohm: 0.007,
        branches: vec![RcBranch {
            r_ohm: 0.004,
            c_f: 100.0,
        }],
    };
    let rows = [
        (0.0, 100.0 * pack.cells()),
        (1.0, -30.0 * pack.cells()),
        (2.0, 0.0),
    ];
    let profile = Profile::new("jump", Demand::Power, Interpolation::Hold, &rows).unwrap();
    let setup = ScatterSetup {
        cell: &cell,
        map: None,
        ocv: &OcvSource::Constant(3.7),
        pack,
        links,
        tab_ohm,
        soc: 0.5,
        profile: &profile,
        window: CellWindow::THESIS,
        thermal: PackThermal::adiabatic(25.0, 66.5),
        max_step_s: 0.01,
    };
    let draws = Draws { draws: 1, seed: 0 };
    scatter(&setup, &Spread::NONE, draws).unwrap().identical
}

fn assert_same(a: &Outcome, b: &Outcome) {
    for (a, b) in [
        (a.min_cell_v, b.min_cell_v),
        (a.max_cell_v, b.max_cell_v),
        (a.min_ccv_v, b.min_ccv_v),
        (a.largest_cell_a, b.largest_cell_a),
        (a.interconnect_heat_j, b.interconnect_heat_j),
        (a.energy_j, b.energy_j),
    ] {
        assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} {b}");
    }
}

#[test]
fn links_in_series_are_the_interconnect() {
    let rows = [
        ("pack-", "1.1-", 0.001),
        ("1.1+", "joint", 0.002),
        ("joint", "2.1-", 0.003),
        ("2.1+", "pack+", 0.004),
    ];
    let met = Links::new(links(&rows), 2, 1).unwrap();
    assert!((met.equivalent_ohm(0.02) - 0.01).abs() < 1e-12);
    let by_links = run(Pack::new(2, 1, 0.0).unwrap(), Some(&met), 0.0);
    assert_same(&by_links, &run(Pack::new(2, 1, 0.01).unwrap(), None, 0.0));
    // Both add up: links, and wires in series with the pack.
    let with_wires = run(Pack::new(2, 1, 0.005).unwrap(), Some(&met), 0.0);
    assert_same(
        &with_wires,
        &run(Pack::new(2, 1, 0.015).unwrap(), None, 0.0),
    );
    let loads = by_links.links.unwrap();
    assert_eq!(
        loads.hottest_path,
        ["pack-", "1.1-", "1.1+", "joint", "2.1-", "2.1+", "pack+"]
    );
    assert!((loads.largest_a - by_links.largest_cell_a).abs() < 1e-9);
    let heat_j: f64 = loads.links.iter().map(|load| load.heat_j).sum();
    assert!((heat_j - by_links.interconnect_heat_j).abs() < 1e-9 * heat_j);
    assert!((loads.links[3].heat_j / heat_j - 0.4).abs() < 1e-9);
    assert!(
        loads
            .links
            .iter()
            .all(|load| (load.largest_a - loads.largest_a).abs() < 1e-9)
    );
}

#[test]
fn links_of_each_cell_to_a_busbar_are_tabs() {
    let mut rows = vec![("pack-", "left", 0.001), ("right", "pack+", 0.002)];
    for (minus, plus) in [("1.1-", "1.1+"), ("1.2-", "1.2+"), ("1.3-", "1.3+")] {
        rows.extend([(minus, "left", 0.003), (plus, "right", 0.002)]);
    }
    let met = Links::new(links(&rows), 1, 3).unwrap();
    let by_links = run(Pack::new(1, 3, 0.0).unwrap(), Some(&met), 0.0);
    assert_same(
        &by_links,
        &run(Pack::new(1, 3, 0.003).unwrap(), None, 0.005),
    );
}

/// Kirchhoff's current law at every node, for cells that differ.
#[test]
fn currents_add_up_at_every_node() {
    let met = Links::new(sheets(4, 3, 0.0007), 4, 3).unwrap();
    let e_v: Vec<f64> = (0..12).map(|k| 3.6 + 0.01 * f64::from(k % 5)).collect();
    let r_ohm: Vec<f64> = (0..12).map(|k| 0.02 + 0.001 * f64::from(k % 7)).collect();
    let mut recent = Recent::default();
    let solved = met.solve(&mut recent, &e_v, &r_ohm).unwrap();
    let (mut cell_a, mut link_a) = (vec![0.0; 12], vec![0.0; met.count()]);
    let load_a = 50.0;
    met.write_currents(solved, &e_v, load_a, &mut cell_a, &mut link_a);
    let mut into_a = vec![0.0; met.nodes.len()];
    (into_a[MINUS], into_a[PLUS]) = (load_a, -load_a);
    let all = met
        .cells
        .iter()
        .zip(&cell_a)
        .chain(met.ends.iter().zip(&link_a));
    for ([a, b], i) in all {
        into_a[*a] -= i;
        into_a[*b] += i;
    }
    assert!(into_a.iter().all(|a| a.abs() < 1e-9), "{into_a:?}");
    // What the cells give, the load, the links and their own resistances take.
    let (e, r) = solved.source();
    let given_w: f64 = e_v.iter().zip(&cell_a).map(|(e, i)| e * i).sum();
    let own_w: f64 = r_ohm.iter().zip(&cell_a).map(|(r, i)| r * i * i).sum();
    let taken_w = (e - load_a * r) * load_a + met.heat_w(&link_a) + own_w;
    assert!((given_w - taken_w).abs() < 1e-9 * given_w);
    assert!(cell_a.iter().any(|i| (i - load_a / 3.0).abs() > 1.0));
}

#[test]
fn the_cells_beside_the_terminals_take_more() {
    let met = Links::new(sheets(4, 3, 0.001), 4, 3).unwrap();
    let loads = run(Pack::new(4, 3, 0.0).unwrap(), Some(&met), 0.0);
    assert!(loads.largest_share > 1.02, "{}", loads.largest_share);
    // Links of a tenth crowd the current less.
    let thick = Links::new(sheets(4, 3, 0.0001), 4, 3).unwrap();
    let fewer = run(Pack::new(4, 3, 0.0).unwrap(), Some(&thick), 0.0);
    assert!(fewer.largest_share - 1.0 < 0.2 * (loads.largest_share - 1.0));
}

/// The most heat of links on the ways that follow the current from a node to `pack+`, W.
fn most_w(met: &Links, cell_a: &[f64], link_a: &[f64], node: usize) -> f64 {
    if node == PLUS {
        return 0.0;
    }
    let heats = met.links.iter().zip(link_a);
    let heats = heats.map(|(link, i)| link.r_ohm * i * i);
    let cells = met.cells.iter().zip(cell_a).map(|(ends, i)| (ends, i, 0.0));
    let links = met.ends.iter().zip(link_a).zip(heats);
    let links = links.map(|((ends, i), heat_w)| (ends, i, heat_w));
    let ways = cells.chain(links).filter_map(|([a, b], i, heat_w)| {
        let (from, to) = if *i > 0.0 { (*a, *b) } else { (*b, *a) };
        (from == node).then(|| heat_w + most_w(met, cell_a, link_a, to))
    });
    ways.fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn the_hottest_path_has_more_heat_than_all_others() {
    let met = Links::new(sheets(3, 4, 0.001), 3, 4).unwrap();
    let (e_v, r_ohm) = ([3.7; 12], [0.02; 12]);
    let mut recent = Recent::default();
    let solved = met.solve(&mut recent, &e_v, &r_ohm).unwrap();
    let (mut cell_a, mut link_a) = ([0.0; 12], vec![0.0; met.count()]);
    for load_a in [50.0, -50.0] {
        met.write_currents(solved, &e_v, load_a, &mut cell_a, &mut link_a);
        let path = met.hottest_path(&cell_a, &link_a);
        let names: Vec<&str> = path.iter().map(|node| &*met.nodes[*node]).collect();
        assert_eq!((path[0], path.last()), (MINUS, Some(&PLUS)), "{names:?}");
        let heat_w: f64 = path
            .windows(2)
            .filter_map(|step| {
                let same = |ends: &&[usize; 2]| step == &ends[..] || step == [ends[1], ends[0]];
                let link = met.ends.iter().position(|ends| same(&ends))?;
                Some(met.links[link].r_ohm * link_a[link].powi(2))
            })
            .sum();
        let currents: (Vec<f64>, Vec<f64>) = match load_a > 0.0 {
            true => (cell_a.to_vec(), link_a.clone()),
            false => (
                cell_a.map(|i| -i).to_vec(),
                link_a.iter().map(|i| -i).collect(),
            ),
        };
        let most_w = most_w(&met, &currents.0, &currents.1, MINUS);
        assert!((heat_w - most_w).abs() < 1e-12 * most_w, "{names:?}");
        assert!(names.contains(&"1.2-"), "most goes on sideways: {names:?}");
    }
}

#[test]
fn heat_warms_a_link_by_its_capacity() {
    let mut rows = sheets(2, 1, 0.001);
    rows[0].heat_j_per_k = Some(0.5);
    let met = Links::new(rows, 2, 1).unwrap();
    let loads = run(Pack::new(2, 1, 0.0).unwrap(), Some(&met), 0.0)
        .links
        .unwrap();
    let load = &loads.links[0];
    assert_eq!(load.rise_k, Some(load.heat_j / 0.5));
    assert_eq!(loads.links[1].rise_k, None);
}

#[test]
fn links_that_are_no_pack_are_refused() {
    let refused = |rows: Vec<Link>, series, parallel| {
        Links::new(rows, series, parallel).unwrap_err().to_string()
    };
    let with = |index: usize, change: fn(&mut Link)| {
        let mut rows = sheets(2, 2, 0.001);
        change(&mut rows[index]);
        refused(rows, 2, 2)
    };
    let cases = [
        (
            with(1, |link| link.r_ohm = 0.0),
            "a resistance of 1e-7 Ω or more, met 0",
        ),
        (with(1, |link| link.r_ohm = f64::NAN), "met NaN"),
        (
            with(1, |link| link.heat_j_per_k = Some(0.0)),
            "a heat capacity above 0 J/K",
        ),
        (
            with(1, |link| link.to = link.from.clone()),
            "two nodes, met",
        ),
        (with(1, |link| link.to.clear()), "the name of a node"),
        (
            with(1, |link| link.to = "3.1-".to_owned()),
            "from 1.1- to 2.2+, met 3.1-",
        ),
    ];
    for (met, expected) in cases {
        assert!(met.contains(expected), "{met}");
    }
    let mut rows = sheets(2, 2, 0.001);
    rows.retain(|link| link.to != "pack+");
    assert_eq!(refused(rows, 2, 2), "expected a link to pack+, met none");
    let mut rows = sheets(2, 2, 0.001);
    rows.push(link("fuse", "shunt", 0.001));
    assert!(refused(rows, 2, 2).contains("from pack- to fuse"));
    let mut rows = sheets(2, 2, 0.001);
    rows.push(link("2.2-", "2.2+", 0.001));
    assert!(refused(rows, 2, 2).contains("through cell 2."));
    // Four cells in series that were said to be two groups of two.
    let rows = [
        ("pack-", "1.1-", 0.001),
        ("1.1+", "1.2-", 0.001),
        ("1.2+", "2.1-", 0.001),
        ("2.1+", "2.2-", 0.001),
        ("2.2+", "pack+", 0.001),
    ];
    assert!(
        refused(links(&rows), 2, 2).contains("2 cells in series from pack- to pack+, met 4.000")
    );
}
