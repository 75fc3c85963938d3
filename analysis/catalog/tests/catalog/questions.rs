//! Questions: conditions, places to go on at, cells and their ageing, tables.

use std::fs;

use analysis_catalog::{query::Filter, record::CatalogVerdict};

use crate::made::{Made, Place, filter};

fn place() -> Place {
    let mut runs: Vec<Made> = (0..230).map(Made::of).collect();
    runs[1].refused = 2;
    runs[2].how = None;
    runs[3].serial = Some("OTHER-1".to_owned());
    runs[4].batch = "2026-04".to_owned();
    let place = Place::with(&runs);
    place.scan();
    place
}

#[test]
fn every_condition_counts() {
    let place = place();
    let number = |filter: Filter| {
        place
            .names(&Filter {
                most: 1000,
                ..filter
            })
            .len()
    };
    let all = Filter::default;
    assert_eq!(number(all()), 230);
    assert_eq!(number(filter(&[("cell", "C07")])), 3);
    assert_eq!(number(filter(&[("cell", "P45B-0007")])), 3);
    assert_eq!(number(filter(&[("serial", "OTHER-1")])), 1);
    for (batch, runs) in [("2026-03", 229), ("2026-04", 1)] {
        assert_eq!(number(filter(&[("batch", batch)])), runs);
    }
    assert_eq!(number(filter(&[("bench", "bench2")])), 46);
    assert_eq!(number(filter(&[("bench", "bench2"), ("cell", "C07")])), 3);
    assert_eq!(number(filter(&[("bench", "bench3"), ("cell", "C07")])), 0);
    assert_eq!(number(filter(&[("text", "RUN00000 ann")])), 10);
    assert_eq!(number(filter(&[("text", "p45b-0007"), ("cell", "C07")])), 3);
    let verdict = |verdict| Filter {
        verdict: Some(verdict),
        ..all()
    };
    assert_eq!(
        place.names(&verdict(CatalogVerdict::Doubtful)),
        ["run000001"]
    );
    assert_eq!(
        place.names(&verdict(CatalogVerdict::Unfinished)),
        ["run000002"]
    );
    let from_unix_s = Some(Made::of(100).started_unix_s());
    let to_unix_s = Some(Made::of(110).started_unix_s());
    assert_eq!(
        number(Filter {
            from_unix_s,
            to_unix_s,
            ..all()
        }),
        10
    );
}

#[test]
fn pages_follow_each_other_without_gaps() {
    let place = place();
    for cell in [None, Some("C07".to_owned())] {
        let whole = Filter {
            most: 1000,
            cell: cell.clone(),
            ..Filter::default()
        };
        let whole = place.names(&whole);
        let mut page = Filter {
            most: 2,
            cell,
            ..Filter::default()
        };
        let mut names = Vec::new();
        loop {
            let found = place.open().runs(&page).unwrap();
            names.extend(found.runs.into_iter().map(|run| run.name));
            page.after = found.after;
            if page.after.is_none() {
                break;
            }
        }
        assert_eq!(names, whole);
    }
    let catalog = place.open();
    let spectra = catalog.all_spectra(&filter(&[("most", "7")])).unwrap();
    assert_eq!(spectra.len(), 230);
    assert!(
        spectra
            .windows(2)
            .all(|pair| pair[0].started_unix_s > pair[1].started_unix_s)
    );
    let first = catalog.cells(&filter(&[("most", "60")])).unwrap();
    let rest = catalog
        .cells(&Filter {
            most: 60,
            after: first.after.clone(),
            ..Filter::default()
        })
        .unwrap();
    let c00 = &first.cells[0];
    assert_eq!(c00.batch.as_deref(), Some("2026-03"));
    assert_eq!(c00.chemistry.as_deref(), Some("NMC / graphite"));
    // C03 has two serial numbers.
    assert_eq!(
        (first.cells.len() + rest.cells.len(), rest.after),
        (101, None)
    );
}

#[test]
fn a_cell_ages_by_models_of_one_order() {
    let place = place();
    fs::remove_file(place.runs.join("run000107/model_2rc.json")).unwrap();
    place.scan();
    let cell = filter(&[("cell", "P45B-0007")]);
    let ageing = place.open().ageing(&cell, None).unwrap();
    assert_eq!((ageing.rc, ageing.orders.clone()), (Some(1), vec![1, 2]));
    let r_ohm: Vec<f64> = ageing.points.iter().map(|one| one.fit.r_ohm).collect();
    assert_eq!(r_ohm, [7, 107, 207].map(|number| Made::of(number).r_ohm()));
    assert_eq!(ageing.points[0].fit.dc_resistance_sigma_ohm, Some(2e-6));
    assert_eq!(place.open().ageing(&cell, Some(2)).unwrap().points.len(), 2);
}

fn all() -> Filter {
    Filter::default()
}

fn text(text: &str) -> Option<String> {
    Some(text.to_owned())
}

/// Returns a place where each condition chooses some runs: of the fourth cell there are two with
/// one name.
fn various() -> Place {
    let mut runs: Vec<Made> = (0..230).map(Made::of).collect();
    runs[1].refused = 2;
    runs[2].how = Some("ended early: interlock: voltage 4.3 V".to_owned());
    runs[3].serial = Some("OTHER-1".to_owned());
    runs[4].batch = "2026-04".to_owned();
    runs[5].barcode = Some("0417 8821".to_owned());
    runs[6].experiment = "formation".to_owned();
    let place = Place::with(&runs);
    place.scan();
    place
}

/// Conditions, each with the numbers of runs, cells, spectra and fits that meet them.
fn conditions() -> Vec<(Filter, [usize; 4])> {
    let from = Some(Made::of(100).started_unix_s());
    let to = Some(Made::of(110).started_unix_s());
    let filter = |change: &dyn Fn(&mut Filter)| {
        let mut filter = all();
        change(&mut filter);
        filter
    };
    let few = |number| [number, number, number, 2 * number];
    vec![
        (filter(&|f| f.bench = text("bench2")), [46, 20, 46, 92]),
        (filter(&|f| f.experiment = text("formation")), few(1)),
        (
            filter(&|f| f.experiment = text("ageing")),
            [229, 101, 229, 458],
        ),
        (
            filter(&|f| f.verdict = Some(CatalogVerdict::Doubtful)),
            few(1),
        ),
        (
            filter(&|f| f.verdict = Some(CatalogVerdict::Failed)),
            few(1),
        ),
        (filter(&|f| f.trip = true), few(1)),
        (filter(&|f| f.text = text("RUN00000 ann")), few(10)),
        (filter(&|f| f.text = text("p45b-0007")), [3, 1, 3, 6]),
        (filter(&|f| f.text = text("swollen")), few(0)),
        (filter(&|f| f.batch = text("2026-04")), few(1)),
        (filter(&|f| f.batch = text("2026-03")), [229, 101, 229, 458]),
        (filter(&|f| f.cell = text("C03")), [3, 2, 3, 6]),
        (filter(&|f| f.cell = text("OTHER-1")), few(1)),
        (filter(&|f| f.serial = text("OTHER-1")), few(1)),
        (filter(&|f| f.serial = text("P45B-0003")), [2, 1, 2, 4]),
        (filter(&|f| f.cell = text("0417 8821")), few(1)),
        (filter(&|f| f.serial = text("0417 8821")), few(1)),
        (
            filter(&|f| (f.cell, f.batch) = (text("C04"), text("2026-03"))),
            [2, 1, 2, 4],
        ),
        (
            filter(&|f| (f.cell, f.serial) = (text("C04"), text("OTHER-1"))),
            few(0),
        ),
        (
            filter(&|f| (f.cell, f.bench) = (text("C07"), text("bench2"))),
            [3, 1, 3, 6],
        ),
        (
            filter(&|f| (f.cell, f.bench) = (text("C07"), text("bench3"))),
            few(0),
        ),
        (
            filter(&|f| (f.from_unix_s, f.to_unix_s) = (from, to)),
            few(10),
        ),
    ]
}

#[test]
fn every_condition_counts_for_every_answer() {
    let place = various();
    let catalog = place.open();
    for (filter, expected) in conditions() {
        let cells = catalog
            .cells(&Filter {
                most: 1000,
                ..filter.clone()
            })
            .unwrap();
        let found = [
            catalog.all_runs(&filter).unwrap().len(),
            cells.cells.len(),
            catalog.all_spectra(&filter).unwrap().len(),
            catalog.all_fits(&filter).unwrap().len(),
        ];
        assert_eq!(found, expected, "{filter:?}");
        // The cells are those of the runs that are found.
        let of_cells: u32 = cells.cells.iter().map(|cell| cell.runs).sum();
        assert_eq!(of_cells as usize, expected[0], "{filter:?}");
        let most = 7;
        let first = catalog
            .fits(&Filter {
                most,
                ..filter.clone()
            })
            .unwrap();
        assert_eq!(first.fits.len(), most.min(expected[3]), "{filter:?}");
        assert_eq!(first.after.is_some(), expected[3] > most, "{filter:?}");
    }
}

#[test]
fn fits_and_diagnoses_are_reported_page_by_page() {
    let place = place();
    for number in (0..230).step_by(10) {
        let run = Made::of(number);
        run.diagnose(&place.runs.join(run.name()).join("diagnosis"));
    }
    place.scan();
    let catalog = place.open();
    let (mut page, mut times, mut runs) = (filter(&[("most", "9")]), Vec::new(), Vec::new());
    loop {
        let found = catalog.fits(&page).unwrap();
        times.extend(found.fits.iter().map(|fit| fit.started_unix_s));
        page.after = found.after;
        if page.after.is_none() {
            break;
        }
    }
    assert_eq!(times.len(), 460);
    assert!(times.windows(2).all(|pair| pair[0] >= pair[1]));
    loop {
        let found = catalog.diagnoses(&page).unwrap();
        runs.extend(found.diagnoses.into_iter().filter_map(|one| one.run));
        page.after = found.after;
        if page.after.is_none() {
            break;
        }
    }
    runs.dedup();
    assert_eq!(runs.len(), 23);
    let bench = filter(&[("bench", "bench0")]);
    assert_eq!(catalog.all_diagnoses(&bench).unwrap().len(), 23);
    let cell = filter(&[("cell", "C10")]);
    let found = catalog.all_diagnoses(&cell).unwrap();
    assert_eq!((found.len(), found[0].cell.as_deref()), (3, Some("C10")));
    let ageing = catalog.ageing(&cell, None).unwrap();
    assert!(ageing.points.iter().all(|one| one.diffusion.len() == 1));
}

#[test]
fn ageing_tells_serial_numbers_that_differ_and_leaves_models_of_several_cells_out() {
    let several = Made {
        cells: vec!["A", "B"],
        ..Made::of(300)
    };
    let mut runs: Vec<Made> = (0..230).map(Made::of).collect();
    runs[3].serial = Some("OTHER-1".to_owned());
    let place = Place::with(&runs);
    several.write(&place.runs);
    place.scan();
    let ageing = |cell: &str, serial: Option<String>| {
        let filter = Filter {
            cell: text(cell),
            serial,
            ..all()
        };
        place.open().ageing(&filter, None).unwrap()
    };
    assert_eq!(ageing("C03", None).serials, ["OTHER-1", "P45B-0003"]);
    let one = ageing("C03", text("P45B-0003"));
    assert_eq!(
        (one.serials.as_slice(), one.points.len()),
        (&["P45B-0003".to_owned()][..], 2)
    );
    // C00 is the type of the cells of the campaign, and also a separate cell.
    let of_type = ageing("C00", None);
    assert_eq!((of_type.points.len(), of_type.pooled), (3, 2));
    let of_one = ageing("A", None);
    assert_eq!(
        (of_one.points.len(), of_one.pooled, of_one.rc),
        (0, 2, None)
    );
}

#[test]
fn folders_are_reported_in_the_order_of_the_runs() {
    let place = place();
    let catalog = place.open();
    let runs = catalog.runs(&filter(&[("most", "3")])).unwrap().runs;
    let wanted: Vec<&str> = runs.iter().rev().map(|run| run.run.as_str()).collect();
    let folders = catalog
        .folders(&[wanted[0], "none", wanted[2], wanted[0]])
        .unwrap();
    let of = |run: usize| Some(runs[2 - run].folder.clone());
    assert_eq!(folders, [of(0), None, of(2), of(0)]);
}

#[test]
fn tables_hold_what_was_asked_for() {
    let place = place();
    let cell = filter(&[("cell", "C07")]);
    let out = place.catalog.with_file_name("spectra.csv");
    let exported = place.open().export_spectra(&out, &cell).unwrap();
    assert_eq!((exported.rows, exported.left_out.len()), (60, 0));
    let text = fs::read_to_string(&out).unwrap();
    assert!(text.starts_with("spectrum_id,freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm"));
    assert_eq!(text.lines().count(), 61);
    let rows = |name: &str| place.catalog.with_file_name(name);
    assert_eq!(
        place
            .open()
            .export_fits(&rows("f.parquet"), &cell)
            .unwrap()
            .rows,
        6
    );
    let words = filter(&[("text", "run00000")]);
    let exported = place.open().export_spectra(&rows("s.csv"), &words).unwrap();
    assert_eq!(exported.rows, 200);
    let exported = place.open().export_fits(&rows("f.csv"), &words).unwrap();
    assert_eq!(exported.rows, 20);
    assert_eq!(
        place
            .open()
            .export_runs(&rows("r.csv"), &cell)
            .unwrap()
            .rows,
        3
    );
    let text = fs::read_to_string(rows("r.csv")).unwrap();
    assert!(
        text.contains(",barcodes,makers,chemistries,terms,"),
        "{text}"
    );
    assert!(
        text.contains("Molicel,NMC / graphite,https://v.example/c,"),
        "{text}"
    );
    let text = fs::read_to_string(&out).unwrap();
    assert!(text.contains("2026-03,NMC / graphite,bench2"), "{text}");
    fs::remove_dir_all(place.runs.join("run000007")).unwrap();
    let exported = place.open().export_spectra(&out, &cell).unwrap();
    assert_eq!((exported.rows, exported.left_out.len()), (40, 1));
}
