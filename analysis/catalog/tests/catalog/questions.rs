//! Questions: conditions, places to go on at, cells and their ageing, tables.

use std::fs;

use analysis_catalog::{query::Filter, record::CatalogVerdict};

use crate::made::{Made, Place};

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
    let text = |text: &str| Some(text.to_owned());
    assert_eq!(number(all()), 230);
    assert_eq!(
        number(Filter {
            cell: text("C07"),
            ..all()
        }),
        3
    );
    assert_eq!(
        number(Filter {
            cell: text("P45B-0007"),
            ..all()
        }),
        3
    );
    assert_eq!(
        number(Filter {
            serial: text("OTHER-1"),
            ..all()
        }),
        1
    );
    for (batch, runs) in [("2026-03", 229), ("2026-04", 1)] {
        assert_eq!(
            number(Filter {
                batch: text(batch),
                ..all()
            }),
            runs
        );
    }
    assert_eq!(
        number(Filter {
            bench: text("bench2"),
            ..all()
        }),
        46
    );
    assert_eq!(
        number(Filter {
            bench: text("bench2"),
            cell: text("C07"),
            ..all()
        }),
        3
    );
    assert_eq!(
        number(Filter {
            bench: text("bench3"),
            cell: text("C07"),
            ..all()
        }),
        0
    );
    assert_eq!(
        number(Filter {
            text: text("RUN00000 ann"),
            ..all()
        }),
        10
    );
    assert_eq!(
        number(Filter {
            text: text("p45b-0007"),
            cell: text("C07"),
            ..all()
        }),
        3
    );
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
    let spectra = catalog
        .all_spectra(&Filter {
            most: 7,
            ..Filter::default()
        })
        .unwrap();
    assert_eq!(spectra.len(), 230);
    assert!(
        spectra
            .windows(2)
            .all(|pair| pair[0].started_unix_s > pair[1].started_unix_s)
    );
    let first = catalog
        .cells(&Filter {
            most: 60,
            ..Filter::default()
        })
        .unwrap();
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
    let cell = Filter {
        cell: Some("P45B-0007".to_owned()),
        ..Filter::default()
    };
    let ageing = place.open().ageing(&cell, None).unwrap();
    assert_eq!((ageing.rc, ageing.orders.clone()), (Some(1), vec![1, 2]));
    let r_ohm: Vec<f64> = ageing.points.iter().map(|one| one.fit.r_ohm).collect();
    assert_eq!(r_ohm, [7, 107, 207].map(|number| Made::of(number).r_ohm()));
    assert_eq!(ageing.points[0].fit.dc_resistance_sigma_ohm, Some(2e-6));
    assert_eq!(place.open().ageing(&cell, Some(2)).unwrap().points.len(), 2);
}

#[test]
fn tables_hold_what_was_asked_for() {
    let place = place();
    let cell = Filter {
        cell: Some("C07".to_owned()),
        ..Filter::default()
    };
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
    assert_eq!(
        place
            .open()
            .export_runs(&rows("r.csv"), &cell)
            .unwrap()
            .rows,
        3
    );
    fs::remove_dir_all(place.runs.join("run000007")).unwrap();
    let exported = place.open().export_spectra(&out, &cell).unwrap();
    assert_eq!((exported.rows, exported.left_out.len()), (40, 1));
}
