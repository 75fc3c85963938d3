//! The points of a map: charge, temperature, voltage at rest, and the files of each.

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use super::MAP_POINTS;

/// The columns of [`MAP_POINTS`]: number of the point; counted state of charge and that of the OCV
/// curve at the voltage at rest; temperature of the cell's surface, °C; voltage at rest, V; charge
/// moved since the full charge, C, charge positive; the file of the spectrum; those of the series,
/// with a semicolon between two.
pub const MAP_POINT_COLUMNS: &str =
    "point,soc,soc_by_ocv,temperature_c,ocv_v,charge_c,spectrum,series";
/// Between the files of one field.
const BETWEEN: char = ';';

/// A point of a map.
#[derive(Debug, Clone, PartialEq)]
pub struct MapPoint {
    /// Its number, from 1.
    pub number: usize,
    /// State of charge, counted from the full charge.
    pub soc: f64,
    /// State of charge of the OCV curve at the voltage at rest; `None` beyond its ends.
    pub soc_by_ocv: Option<f64>,
    /// Temperature of the cell's surface at rest, °C; `None` if it was not measured.
    pub temperature_degc: Option<f64>,
    /// Voltage at rest, V.
    pub ocv_v: f64,
    /// Charge moved since the full charge, C, charge positive.
    pub charge_coulomb: f64,
    /// The corrected spectrum, if there is one.
    pub spectrum: Option<PathBuf>,
    /// The rows of the pulses.
    pub series: Vec<PathBuf>,
}

/// A table of points that cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapPointsError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A field cannot be what it is.
    #[error("{}:{line}, {field}: expected {expected}, found {found:?}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// The column, or `header`.
        field: &'static str,
        /// What was expected.
        expected: &'static str,
        /// What was found.
        found: String,
    },
}

/// Reads the points of the map in a run folder. The paths begin with that of the folder.
///
/// # Errors
/// [`MapPointsError`] if there is no table, or if a field is not what its column holds.
pub fn read_map_points(folder: &Path) -> Result<Vec<MapPoint>, MapPointsError> {
    let path = folder.join(MAP_POINTS);
    let text = std::fs::read_to_string(&path).map_err(|source| MapPointsError::Io {
        path: path.clone(),
        source,
    })?;
    let mut lines = (1..).zip(text.lines());
    let header = lines.next().map_or("", |(_, line)| line);
    if header != MAP_POINT_COLUMNS {
        return Err(MapPointsError::Field {
            path,
            line: 1,
            field: "header",
            expected: MAP_POINT_COLUMNS,
            found: header.to_owned(),
        });
    }
    lines
        .filter(|(_, line)| !line.is_empty())
        .map(|(line, row)| {
            let fields = Fields {
                path: &path,
                line,
                row,
            };
            fields.point(folder)
        })
        .collect()
}

/// Returns the table of points as text; paths in `folder` are written without it.
pub fn map_points_csv(folder: &Path, points: &[MapPoint]) -> String {
    let name = |path: &PathBuf| {
        let own = path.strip_prefix(folder).unwrap_or(path);
        own.display().to_string()
    };
    let value_text = |value: Option<f64>, digits: usize| {
        value.map_or_else(String::new, |value| format!("{value:.digits$}"))
    };
    let mut text = format!("{MAP_POINT_COLUMNS}\n");
    for point in points {
        let series: Vec<String> = point.series.iter().map(name).collect();
        let _ = writeln!(
            text,
            "{},{:.6},{},{},{:.5},{:.2},{},{}",
            point.number,
            point.soc,
            value_text(point.soc_by_ocv, 6),
            value_text(point.temperature_degc, 3),
            point.ocv_v,
            point.charge_coulomb,
            point.spectrum.as_ref().map_or_else(String::new, name),
            series.join(&BETWEEN.to_string())
        );
    }
    text
}

/// The fields of one row.
struct Fields<'a> {
    path: &'a Path,
    line: usize,
    row: &'a str,
}

impl Fields<'_> {
    fn point(&self, folder: &Path) -> Result<MapPoint, MapPointsError> {
        let cells: Vec<&str> = self.row.split(',').collect();
        let &[number, soc, by_ocv, degc, ocv, charge, spectrum, series] = cells.as_slice() else {
            return Err(self.fail("row", "8 fields", &format!("{} fields", cells.len())));
        };
        let files = |field: &str| -> Vec<PathBuf> {
            let named = field.split(BETWEEN).filter(|name| !name.is_empty());
            named.map(|name| folder.join(name)).collect()
        };
        let missing = |field: &str| field.is_empty();
        Ok(MapPoint {
            number: number
                .parse()
                .map_err(|_| self.fail("point", "the number of a point", number))?,
            soc: self.number("soc", soc)?,
            soc_by_ocv: (!missing(by_ocv))
                .then(|| self.number("soc_by_ocv", by_ocv))
                .transpose()?,
            temperature_degc: (!missing(degc))
                .then(|| self.number("temperature_c", degc))
                .transpose()?,
            ocv_v: self.number("ocv_v", ocv)?,
            charge_coulomb: self.number("charge_c", charge)?,
            spectrum: files(spectrum).into_iter().next(),
            series: files(series),
        })
    }

    fn number(&self, field: &'static str, text: &str) -> Result<f64, MapPointsError> {
        let number = text.parse().ok().filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| self.fail(field, "a number", text))
    }

    fn fail(&self, field: &'static str, expected: &'static str, found: &str) -> MapPointsError {
        MapPointsError::Field {
            path: self.path.to_owned(),
            line: self.line,
            field,
            expected,
            found: found.to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(folder: &Path) -> MapPoint {
        MapPoint {
            number: 3,
            soc: 0.4987,
            soc_by_ocv: Some(0.501_25),
            temperature_degc: Some(10.125),
            ocv_v: 3.711_25,
            charge_coulomb: -8120.5,
            spectrum: Some(folder.join("spectra/point_3.csv")),
            series: vec![folder.join("series_pulses_3.bdf.csv")],
        }
    }

    #[test]
    fn the_points_come_back_with_the_paths_of_their_files() {
        let folder = tempfile::tempdir().unwrap();
        let bare = MapPoint {
            number: 4,
            soc_by_ocv: None,
            temperature_degc: None,
            spectrum: None,
            series: Vec::new(),
            ..point(folder.path())
        };
        let points = [point(folder.path()), bare];
        let text = map_points_csv(folder.path(), &points);
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(
            rows[1],
            "3,0.498700,0.501250,10.125,3.71125,-8120.50,spectra/point_3.csv,\
            series_pulses_3.bdf.csv"
        );
        assert_eq!(rows[2], "4,0.498700,,,3.71125,-8120.50,,");
        std::fs::write(folder.path().join(MAP_POINTS), &text).unwrap();
        assert_eq!(read_map_points(folder.path()).unwrap(), points);
    }

    #[test]
    fn what_is_not_a_table_of_points_is_refused_with_line_and_field() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |text: &str| {
            std::fs::write(folder.path().join(MAP_POINTS), text).unwrap();
            let error = read_map_points(folder.path()).unwrap_err().to_string();
            error.replace(&format!("{}/", folder.path().display()), "")
        };
        let table = |row: &str| format!("{MAP_POINT_COLUMNS}\n{row}\n");
        assert_eq!(
            refused(&table("1,half,,,3.7,0,,")),
            "map_points.csv:2, soc: expected a number, found \"half\""
        );
        assert_eq!(
            refused(&table("1,0.5,,NaN,3.7,0,,")),
            "map_points.csv:2, temperature_c: expected a number, found \"NaN\""
        );
        assert_eq!(
            refused(&table("one,0.5,,,3.7,0,,")),
            "map_points.csv:2, point: expected the number of a point, found \"one\""
        );
        assert_eq!(
            refused(&table("1,0.5")),
            "map_points.csv:2, row: expected 8 fields, found \"2 fields\""
        );
        assert!(refused("soc\n0.5\n").starts_with("map_points.csv:1, header: expected point,soc,"));
        std::fs::remove_file(folder.path().join(MAP_POINTS)).unwrap();
        let missing = read_map_points(folder.path()).unwrap_err().to_string();
        assert!(
            missing.contains("map_points.csv: No such file"),
            "{missing}"
        );
    }
}
