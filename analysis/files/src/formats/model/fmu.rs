//! An FMU: description, sources and, where a compiler was found, a library, in one archive.

use std::fmt::Write as _;
use std::io::{self, Cursor, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};

use super::added::Added;
use super::cell::CellModel;
use super::error::{ModelExportError, ModelFormat};
use super::text::{fill, harmless, identifier};
use zip::{ZipWriter, write::SimpleFileOptions};

const SOURCE: &str = include_str!("fmu.c.in");
const DESCRIPTION: &str = include_str!("fmu.xml.in");
const BUILD: &str = include_str!("fmu_build.xml.in");
/// Longest step within a step of a co-simulation, s.
const LONGEST_STEP_S: f64 = 2.5e-4;
/// Reference of the first state; as in the source.
const FIRST_STATE: usize = 14;

/// The texts of an FMU.
#[derive(Debug, Clone, PartialEq)]
pub struct Fmu {
    /// Name of its library, without an extension.
    pub identifier: String,
    /// Description of the model.
    description: String,
    /// Name and text of each source.
    sources: Vec<(&'static str, String)>,
}

impl CellModel {
    /// Returns the model as an FMU (FMI 3.0, model exchange and co-simulation) without a library.
    ///
    /// # Errors
    /// As [`CellModel::text`].
    pub fn fmu(&self) -> Result<Fmu, ModelExportError> {
        let header = self.text(ModelFormat::CHeader)?;
        let (ambient, start) = match self.map {
            Some(_) => ("ambient_degc, ", ", ambient_degc"),
            None => ("", ""),
        };
        let states = self.states();
        let first_rate = FIRST_STATE + states.len();
        let (mut variables, mut structure) = (String::new(), String::new());
        // Writing to a string cannot fail.
        for (state, name) in (FIRST_STATE..).zip(&states) {
            let _ = writeln!(
                variables,
                "    <Float64 name=\"state.{name}\" valueReference=\"{state}\" causality=\"local\" \
                initial=\"calculated\"/>"
            );
        }
        for ((rate, state), name) in (first_rate..).zip(FIRST_STATE..).zip(&states) {
            let _ = writeln!(
                variables,
                "    <Float64 name=\"der(state.{name})\" valueReference=\"{rate}\" \
                causality=\"local\" derivative=\"{state}\"/>"
            );
            let element = "    <ContinuousStateDerivative valueReference=";
            let _ = writeln!(structure, "{element}\"{rate}\"/>");
        }
        let outputs = FIRST_STATE - 6..first_rate + states.len();
        for unknown in outputs {
            let _ = writeln!(
                structure,
                "    <InitialUnknown valueReference=\"{unknown}\"/>"
            );
        }
        let marks = [
            ("@GIVEN_AMBIENT@", ambient.to_owned()),
            ("@GIVEN_START@", start.to_owned()),
            ("@LONGEST_STEP_S@", format!("{LONGEST_STEP_S:?}")),
            ("@FMU_VARIABLES@", variables.trim_end().to_owned()),
            ("@FMU_STRUCTURE@", structure.trim_end().to_owned()),
            ("@FMU_DESCRIPTION@", self.description()),
            ("@IDENTIFIER@", identifier(&self.name)),
            ("@TOKEN@", token(&header)),
        ];
        let filled = |template| fill(&fill(template, &marks), &self.marks(ModelFormat::CHeader));
        let sources = vec![
            ("buildDescription.xml", filled(BUILD)),
            ("fmu.c", filled(SOURCE)),
            ("model.h", header),
        ];
        Ok(Fmu {
            identifier: identifier(&self.name),
            description: filled(DESCRIPTION),
            sources,
        })
    }

    /// Names of the states of the C header, in its order.
    fn states(&self) -> Vec<String> {
        let temperature = self.map.as_ref().map(|_| "temperature_degc".to_owned());
        let count = self.erm.branches.len().max(1);
        let branches = match &self.map {
            Some(map) => map.branches.len().max(1),
            None => count,
        };
        std::iter::once("soc".to_owned())
            .chain(temperature)
            .chain((1..=branches).map(|k| format!("branch_v[{k}]")))
            .chain(self.added.iter().flat_map(Added::states))
            .collect()
    }

    fn description(&self) -> String {
        let notes = self.notes.join("; ");
        harmless(&format!("Lithium-ion cell. {notes}"))
    }
}

impl Fmu {
    /// Returns the sources as one text for a C compiler.
    pub fn code(&self) -> String {
        let text = |wanted: &str| {
            let found = self.sources.iter().find(|(name, _)| *name == wanted);
            found.map_or("", |(_, text)| text.as_str())
        };
        text("fmu.c").replace("#include \"model.h\"\n", text("model.h"))
    }

    /// Compiles the library for Linux on x86-64 by the machine's `cc`. It is written into a folder, read
    /// and removed.
    ///
    /// # Errors
    /// Why the machine has none: another platform, no compiler, its first message.
    pub fn library(&self, folder: &Path) -> Result<Vec<u8>, String> {
        if !cfg!(all(target_os = "linux", target_arch = "x86_64")) {
            return Err("a library is compiled on Linux on x86-64".to_owned());
        }
        let path = folder.join(format!(".{}.so", self.identifier));
        let read = || std::fs::read(&path).map_err(|error| error.to_string());
        let library = self.compile(&path).and_then(|()| read());
        // It was read, or not written.
        let _ = std::fs::remove_file(&path);
        library.map_err(|reason| format!("cc: {reason}"))
    }

    fn compile(&self, path: &Path) -> Result<(), String> {
        let fail = |error: io::Error| error.to_string();
        let mut child = Command::new("cc")
            .args(["-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden"])
            .arg("-o")
            .arg(path)
            .args(["-x", "c", "-", "-lm"])
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(fail)?;
        if let Some(mut input) = child.stdin.take() {
            // A compiler that ends early says why below.
            let _ = input.write_all(self.code().as_bytes());
        }
        let ended = child.wait_with_output().map_err(fail)?;
        if ended.status.success() {
            return Ok(());
        }
        let message = String::from_utf8_lossy(&ended.stderr);
        Err(message.lines().next().unwrap_or_default().to_owned())
    }

    /// Returns the archive, with a library for Linux on x86-64 if one is given.
    ///
    /// # Errors
    /// [`ModelExportError::Archive`] for an archive that cannot be written.
    pub fn archive(&self, library: Option<&[u8]>) -> Result<Vec<u8>, ModelExportError> {
        let fail = |error: &dyn std::fmt::Display| ModelExportError::Archive {
            message: error.to_string(),
        };
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        let described = (
            "modelDescription.xml".to_owned(),
            self.description.as_bytes(),
        );
        let sources = self
            .sources
            .iter()
            .map(|(name, text)| (format!("sources/{name}"), text.as_bytes()));
        let binary = library.map(|bytes| {
            let name = &self.identifier;
            (format!("binaries/x86_64-linux/{name}.so"), bytes)
        });
        for (name, bytes) in std::iter::once(described).chain(sources).chain(binary) {
            archive
                .start_file(name, SimpleFileOptions::default())
                .map_err(|error| fail(&error))?;
            archive.write_all(bytes).map_err(|error| fail(&error))?;
        }
        let done = archive.finish().map_err(|error| fail(&error))?;
        Ok(done.into_inner())
    }
}

/// A token that changes with the model: FNV-1a.
fn token(text: &str) -> String {
    let hash = |seed: u64| {
        text.bytes().fold(seed, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        })
    };
    let (a, b) = (hash(0xcbf2_9ce4_8422_2325), hash(0x8422_2325_cbf2_9ce4));
    format!("{{{a:016x}{b:016x}}}")
}
