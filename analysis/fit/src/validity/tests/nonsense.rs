//! How often the verdicts are wrong: nonsense that is called good, sound spectra that are not.
//! `cargo test -p analysis-fit nonsense -- --nocapture` prints the counts.

use super::*;
use std::collections::BTreeMap;

/// A value of each kind, by name.
type Made = (&'static str, Spectrum);

/// Grid, cell and noise of a measurement as people make them.
struct Sweep {
    freqs_hz: Vec<f64>,
    z_ohm: Vec<Complex64>,
    sigma: f64,
    stated: bool,
}

impl Sweep {
    /// A cell or a sample of any size over three to seven decades.
    fn any(noise: &mut Noisy) -> (&'static str, Self) {
        let decades = noise.between(3.0, 7.0);
        let per_decade = noise.between(5.0, 12.0);
        let low_hz = noise.log_between(1e-3, 1.0);
        let points = ((decades * per_decade) as u32).clamp(15, 80);
        let freqs_hz = grid(points, low_hz, low_hz * 10f64.powf(decades));
        let size = noise.log_between(1e-3, 1e5);
        let (kind, z) = any_system(noise, (low_hz, low_hz * 10f64.powf(decades)));
        let sigma = noise.log_between(1e-4, 1e-2);
        let stated = noise.between(0.0, 1.0) < 0.3;
        let z_ohm = freqs_hz.iter().map(|f| size * z(*f)).collect();
        let sweep = Self {
            freqs_hz,
            z_ohm,
            sigma,
            stated,
        };
        (kind, sweep)
    }

    /// The same with 1 to 4 % of noise, of which nothing is stated.
    fn noisy(noise: &mut Noisy) -> (&'static str, Self) {
        let (kind, sweep) = Self::any(noise);
        let sigma = noise.log_between(1e-2, 4e-2);
        (
            kind,
            Self {
                sigma,
                stated: false,
                ..sweep
            },
        )
    }

    fn spectrum(&self, noise: &mut Noisy) -> Spectrum {
        let point = |(freq_hz, z): (&f64, &Complex64)| {
            let s = self.sigma * z.norm();
            let covariance = if self.stated {
                Covariance2::circular(s * s)
            } else {
                Covariance2::UNKNOWN
            };
            ImpedancePoint {
                freq_hz: *freq_hz,
                z_ohm: z + Complex64::new(s * noise.normal(), s * noise.normal()),
                covariance,
                amplitude_a: f64::NAN,
            }
        };
        Spectrum::new(
            "made",
            self.freqs_hz.iter().zip(&self.z_ohm).map(point).collect(),
        )
    }
}

/// A passive system whose relaxations lie in a band.
fn any_system(
    noise: &mut Noisy,
    (lo_hz, hi_hz): (f64, f64),
) -> (&'static str, Box<dyn Fn(f64) -> Complex64>) {
    let (fast, slow) = (1.0 / (TAU * hi_hz), 1.0 / (TAU * lo_hz));
    let arcs: Vec<(f64, f64, f64)> = (0..1 + (noise.between(0.0, 3.0) as usize))
        .map(|_| {
            (
                noise.log_between(0.05, 2.0),
                noise.log_between(3.0 * fast, 0.3 * slow),
                noise.between(0.6, 1.0),
            )
        })
        .collect();
    let cell = move |f: f64| -> Complex64 {
        let arc = |(r, tau, alpha): &(f64, f64, f64)| *r / (1.0 + power(TAU * f * tau, *alpha));
        1.0 + arcs.iter().map(arc).sum::<Complex64>()
    };
    match (noise.between(0.0, 7.0)) as usize {
        0 => ("arcs", Box::new(cell)),
        1 => {
            let l = noise.between(0.2, 2.0) / (TAU * hi_hz);
            (
                "arcs and inductance",
                Box::new(move |f| cell(f) + Complex64::new(0.0, TAU * f * l)),
            )
        }
        2 => {
            let a = noise.between(0.05, 0.5) * (TAU * lo_hz).sqrt();
            (
                "arcs and diffusion",
                Box::new(move |f| cell(f) + a * power(TAU * f, -0.5)),
            )
        }
        3 => {
            let c = noise.log_between(0.1, 30.0) * TAU * lo_hz;
            (
                "arcs and a blocking end",
                Box::new(move |f| cell(f) + c * power(TAU * f, -1.0)),
            )
        }
        4 => {
            let (r, tau) = (
                noise.between(0.1, 0.6),
                noise.log_between(0.03 * slow, 0.5 * slow),
            );
            (
                "a slow loop",
                Box::new(move |f| cell(f) - r / Complex64::new(1.0, TAU * f * tau)),
            )
        }
        5 => ("a resistor", Box::new(|_| Complex64::from(1.0))),
        _ => {
            // A coating: no series resistance to speak of.
            ("an arc from zero", Box::new(move |f| cell(f) - 0.999))
        }
    }
}

/// A spectrum that no cell gives.
fn any_nonsense(noise: &mut Noisy, kind: usize) -> Made {
    let (_, mut sweep) = loop {
        let (name, sweep) = Sweep::any(noise);
        // Of a resistor, exchanged values are still a resistor.
        if name != "a resistor" {
            break (name, sweep);
        }
    };
    sweep.stated = false;
    let n = sweep.z_ohm.len();
    let shuffle = |noise: &mut Noisy, z: &mut [Complex64], which: &[usize]| {
        for k in (1..which.len()).rev() {
            z.swap(which[k], which[noise.between(0.0, (k + 1) as f64) as usize]);
        }
    };
    let some = |noise: &mut Noisy, share: f64| -> Vec<usize> {
        (0..n).filter(|_| noise.between(0.0, 1.0) < share).collect()
    };
    let name = match kind {
        0 => {
            shuffle(noise, &mut sweep.z_ohm, &(0..n).collect::<Vec<_>>());
            "values permuted over the frequencies"
        }
        1 => {
            sweep.sigma = noise.between(0.1, 0.5);
            "noise of 10 to 50 %"
        }
        2 => {
            let which = some(noise, 0.41);
            shuffle(noise, &mut sweep.z_ohm, &which);
            "two fifths of the frequencies exchanged"
        }
        3 => {
            let spectrum = sweep.spectrum(noise);
            let mut points = spectrum.points;
            let (lo, hi) = (sweep.freqs_hz[0], sweep.freqs_hz[n - 1]);
            for k in some(noise, 0.41) {
                points[k].freq_hz = noise.log_between(lo, hi);
            }
            let mut spectrum = Spectrum::new("made", points);
            spectrum.sort();
            return ("two fifths of the frequencies drawn by lot", spectrum);
        }
        4 => {
            let size = sweep.z_ohm[n / 2].norm();
            for z in &mut sweep.z_ohm {
                *z = size * Complex64::new(noise.between(0.5, 2.0), noise.between(-1.0, 0.2));
            }
            "values drawn by lot"
        }
        7 => {
            let mut points = sweep.spectrum(noise).points;
            for k in some(noise, 0.41) {
                points[k].freq_hz *= noise.log_between(1.0 / 1.5, 1.5);
            }
            let mut spectrum = Spectrum::new("made", points);
            spectrum.sort();
            return (
                "two fifths of the frequencies off by up to a half",
                spectrum,
            );
        }
        5 => {
            for k in some(noise, 0.4) {
                sweep.z_ohm[k] = sweep.z_ohm[k].conj();
            }
            "the sign of two fifths of the imaginary parts turned"
        }
        _ => {
            let mean = sweep.z_ohm.iter().sum::<Complex64>() / n as f64;
            let mut walk = Complex64::from(0.0);
            for z in &mut sweep.z_ohm {
                walk += 0.3 * mean.norm() * Complex64::new(noise.normal(), noise.normal());
                *z = mean + walk;
            }
            "a random walk"
        }
    };
    (name, sweep.spectrum(noise))
}

/// Number of spectra by kind and grade.
type Counts = BTreeMap<&'static str, BTreeMap<Grade, u32>>;

fn count(made: impl Iterator<Item = Made>) -> Counts {
    let mut counts = Counts::new();
    for (kind, spectrum) in made {
        let grade = judge(&spectrum).grade;
        *counts.entry(kind).or_default().entry(grade).or_default() += 1;
    }
    counts
}

fn of(counts: &Counts, grade: Grade) -> u32 {
    counts.values().filter_map(|by| by.get(&grade)).sum()
}

#[test]
fn nonsense_is_not_good_and_sound_spectra_are() {
    let mut noise = Noisy::new(460);
    let nonsense = count((0..200).map(|k| any_nonsense(&mut noise, k % 7)));
    let sound = count((0..500).map(|_| {
        let (kind, sweep) = Sweep::any(&mut noise);
        (kind, sweep.spectrum(&mut noise))
    }));
    let near = count((0..50).map(|_| any_nonsense(&mut noise, 7)));
    let noisy = count((0..200).map(|_| {
        let (kind, sweep) = Sweep::noisy(&mut noise);
        (kind, sweep.spectrum(&mut noise))
    }));
    for (name, counts) in [
        ("nonsense", &nonsense),
        ("sound", &sound),
        ("wrong by little", &near),
        ("sound with 1 to 4 % of noise", &noisy),
    ] {
        let grades = [
            Grade::Good,
            Grade::Doubtful,
            Grade::CannotBeJudged,
            Grade::Bad,
        ];
        println!("{name}: {:?}", grades.map(|g| (g.name(), of(counts, g))));
        counts
            .iter()
            .for_each(|(kind, by)| println!("    {kind}: {by:?}"));
    }
    assert!(of(&nonsense, Grade::Good) <= 6, "{nonsense:?}");
    assert!(
        of(&nonsense, Grade::Good) + of(&nonsense, Grade::Doubtful) <= 20,
        "{nonsense:?}"
    );
    assert!(
        of(&sound, Grade::Bad) + of(&sound, Grade::CannotBeJudged)
            <= most_by_chance(500, FALSE_ALARM_RATE),
        "{sound:?}"
    );
    assert!(
        500 - of(&sound, Grade::Good) <= most_by_chance(500, DOUBTFUL_RATE),
        "{sound:?}"
    );
    // In this noise a resistor cannot be distinguished from exchanged values.
    assert!(
        of(&noisy, Grade::Bad) <= most_by_chance(200, FALSE_ALARM_RATE),
        "{noisy:?}"
    );
}
