use super::scene::{Scene, Shape};
use super::*;
use analysis_numeric::Covariance2;
use num_complex::Complex64;

/// Returns the impedance of 6.9 mΩ, 1.7 mΩ ∥ 1.17 F and 2.6 mΩ ∥ 750 F, Ω.
fn cell(freq_hz: f64) -> Complex64 {
    let omega = std::f64::consts::TAU * freq_hz;
    let branch = |r_ohm: f64, c_f: f64| r_ohm / Complex64::new(1.0, omega * r_ohm * c_f);
    0.0069 + branch(0.0017, 1.17) + branch(0.0026, 750.0)
}

fn sweep(scale: f64) -> Vec<SeriesPoint> {
    let variance = 1e-10;
    let covariance = Covariance2 {
        re_re: variance,
        re_im: 0.3 * variance,
        im_im: 0.5 * variance,
    };
    let at = |k: u32| 0.1 * 3000f64.powf(f64::from(k) / 20.0);
    let point = |freq_hz| SeriesPoint {
        freq_hz,
        z_ohm: cell(freq_hz) * scale,
        covariance,
    };
    (0..20).map(|k| point(at(k))).collect()
}

fn plot() -> ImpedancePlot {
    let series = vec![
        Series::data("a", sweep(1.0), 0),
        Series::curve("model", 0.1..=201.0, 1, cell),
    ];
    ImpedancePlot::new("Title", "Subtitle", series)
}

/// Returns the frame's rectangle: the closed line of five points.
fn frames(scene: &Scene) -> Vec<[f64; 4]> {
    let corners = |s: &Shape| match s {
        Shape::Line { points, .. } if points.len() == 5 && points[0] == points[4] => {
            Some([points[0].0, points[0].1, points[2].0, points[2].1])
        }
        _ => None,
    };
    scene.shapes.iter().filter_map(corners).collect()
}

fn discs(scene: &Scene) -> Vec<(f64, f64)> {
    scene
        .shapes
        .iter()
        .filter_map(|s| {
            if let Shape::Disc { at, .. } = s {
                Some(*at)
            } else {
                None
            }
        })
        .collect()
}

#[test]
fn both_axes_of_a_nyquist_plot_have_one_scale() {
    for (scale, width_px) in [(1.0, 900), (1.0, 500), (4.0, 1600), (300.0, 900)] {
        let plot = ImpedancePlot {
            width_px,
            ..ImpedancePlot::new("t", "", vec![Series::data("a", sweep(scale), 0)])
        };
        let scene = nyquist::layout(&plot).unwrap();
        let places = discs(&scene).split_off(1);
        let z: Vec<Complex64> = plot.series[0].points.iter().map(|p| p.z_ohm).collect();
        assert_eq!(places.len(), z.len());
        let per_ohm_x = (places[19].0 - places[0].0) / (z[19].re - z[0].re);
        let per_ohm_y = (places[19].1 - places[0].1) / (z[19].im - z[0].im);
        assert!(
            (per_ohm_x / per_ohm_y - 1.0).abs() < 1e-9,
            "{scale}, {width_px} px: {per_ohm_x} against {per_ohm_y} px/Ω"
        );
        assert!(per_ohm_x > 0.0);
    }
}

#[test]
fn marks_stay_inside_and_words_of_the_legend_outside() {
    for layout in [nyquist::layout, bode::layout] {
        let scene = layout(&plot()).unwrap();
        let frames = frames(&scene);
        let within =
            |(x, y): (f64, f64), f: &[f64; 4]| x >= f[0] && x <= f[2] && y >= f[1] && y <= f[3];
        let top = frames[0][1];
        assert!(
            frames
                .iter()
                .all(|f| f[2] <= scene.width && f[3] <= scene.height)
        );
        for at in discs(&scene).into_iter().filter(|at| at.1 > top) {
            assert!(
                frames.iter().any(|f| within(at, f)),
                "{at:?} outside of {frames:?}"
            );
        }
        for word in ["Title", "Subtitle", "a", "model"] {
            let found = scene.shapes.iter().find_map(|s| match s {
                Shape::Label(l) if l.text == word => Some(l.at.1),
                _ => None,
            });
            assert!(found.unwrap() < top, "{word} must stand above the axes");
        }
    }
}

#[test]
fn bode_spans_whole_decades() {
    let svg = bode_svg(&plot()).unwrap();
    for label in ["0.1", "1", "10", "100", "1000"] {
        assert!(svg.contains(&format!(">\n{label}\n</text>")), "{label}");
    }
    assert!(!svg.contains(">\n0.01\n</text>"));
}

#[test]
fn svg_says_what_it_shows_and_escapes_it() {
    let mut plot = plot();
    plot.title = "A <b> & \"c\"".into();
    let svg = nyquist_svg(&plot).unwrap();
    assert!(
        svg.starts_with(
            "<svg role=\"img\" aria-label=\"A &lt;b&gt; &amp; &quot;c&quot;\" \
    width=\"900\" height=\""
        ),
        "{}",
        &svg[..120]
    );
    assert!(!svg.contains("<b>"));
    assert!(svg.contains("−Im Z / mΩ") && svg.trim_end().ends_with("</svg>"));
    assert_eq!(
        svg,
        nyquist_svg(&plot).unwrap(),
        "equal descriptions give equal files"
    );
    let large = ImpedancePlot::new("t", "", vec![Series::data("a", sweep(300.0), 0)]);
    assert!(nyquist_svg(&large).unwrap().contains("−Im Z / Ω"));
}

#[test]
fn files_follow_their_names() {
    let dir = tempfile::tempdir().unwrap();
    let png = dir.path().join("n.png");
    nyquist(&plot(), &png).unwrap();
    let bytes = std::fs::read(&png).unwrap();
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
    assert_eq!(
        u32::from_be_bytes(bytes[16..20].try_into().unwrap()),
        1800,
        "twice the natural width"
    );
    let svg = dir.path().join("b.SVG");
    bode(&plot(), &svg).unwrap();
    assert_eq!(
        std::fs::read_to_string(&svg).unwrap(),
        bode_svg(&plot()).unwrap()
    );
    let jpg = dir.path().join("n.jpg");
    assert!(
        nyquist(&plot(), &jpg)
            .unwrap_err()
            .to_string()
            .ends_with("n.jpg: expected a file name that ends in .svg or .png")
    );
    for name in ["no/n.svg", "no/n.png"] {
        let error = nyquist(&plot(), &dir.path().join(name))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(&format!("{name}: expected to write a plot: ")),
            "{error}"
        );
    }
}

#[test]
fn nothing_and_nonsense_are_refused() {
    let empty = ImpedancePlot::new("Empty", "", vec![]);
    assert_eq!(
        nyquist_svg(&empty).unwrap_err().to_string(),
        "plot \"Empty\": expected at least one point, met none"
    );
    let mut bad = plot();
    bad.series[0].points[2].z_ohm.re = f64::INFINITY;
    bad.series[0].points[2].z_ohm.im = 0.0;
    bad.series[0].points[2].freq_hz = 3.0;
    let expected = "plot \"Title\": expected a finite impedance at a positive finite frequency, \
    met inf+0i Ω at 3 Hz";
    assert_eq!(bode_svg(&bad).unwrap_err().to_string(), expected);
}

#[test]
fn degenerate_spectra_are_drawn() {
    let point = |freq_hz, z_ohm| SeriesPoint {
        freq_hz,
        z_ohm,
        covariance: Covariance2::UNKNOWN,
    };
    for z in [
        Complex64::new(0.01, 0.0),
        Complex64::ZERO,
        Complex64::new(0.0, -1e-9),
        Complex64::new(-1e3, 5e3),
    ] {
        for points in [
            vec![point(1.0, z)],
            vec![point(1.0, z), point(1.0, z), point(2.0, z)],
        ] {
            let series = Series {
                label: Some("x".into()),
                colour: 3,
                style: SeriesStyle::Points,
                points,
            };
            let plot = ImpedancePlot::new(
                "t",
                "",
                vec![series.clone(), series.styled(SeriesStyle::Curve)],
            );
            for svg in [nyquist_svg(&plot).unwrap(), bode_svg(&plot).unwrap()] {
                assert!(!svg.contains("NaN") && !svg.contains("inf"), "{z}");
            }
        }
    }
}
