//! Small run folders, and what a store must hold of them.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use analysis_catalog::rows::DiagnosisFolder;
use analysis_files::run_folder::{
    self, DIAGNOSIS, INDEX, JOURNAL, MANIFEST, SPECTRUM, SUMS, sums::files_of,
};
use bench_archive::{
    ArchiveError, Store,
    push::{Now, Outcome, Pusher},
    receipt::{Kept, Receipt, Receipts},
    snapshot::RunSource,
};
use futures_util::TryStreamExt;
use object_store::{ObjectStore, ObjectStoreExt, memory::InMemory};
use serde_json::json;
use sha2::{Digest, Sha256};

use crate::faults::{Faults, Faulty};

/// Start of the run, s since 1970: 14 November 2023 in UTC.
pub(crate) const STARTED_S: f64 = 1.7e9;

pub(crate) fn sha256(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A data folder with run folders, and a store.
pub(crate) struct Place {
    pub(crate) folder: tempfile::TempDir,
    /// Content of the store, without faults.
    pub(crate) inner: Arc<InMemory>,
    /// The faults of the store.
    pub(crate) faults: Arc<Faults>,
    /// The store.
    pub(crate) store: Store,
    /// Site of the pushes.
    pub(crate) site: &'static str,
}

impl Place {
    pub(crate) fn new() -> Self {
        Self::with(Arc::new(InMemory::new()))
    }

    /// A data folder of its own with a store that others use, too.
    pub(crate) fn with(inner: Arc<InMemory>) -> Self {
        let faults = Arc::new(Faults::default());
        let faulty = Faulty {
            inner: inner.clone(),
            faults: faults.clone(),
        };
        Self {
            folder: tempfile::tempdir().unwrap(),
            inner,
            faults,
            store: Store::of(Arc::new(faulty), "memory".to_owned()),
            site: "north",
        }
    }

    pub(crate) fn runs(&self) -> PathBuf {
        self.folder.path().join("runs")
    }

    pub(crate) fn receipts(&self) -> Receipts {
        Receipts::of(self.folder.path()).unwrap()
    }

    pub(crate) fn receipt(&self, source: &RunSource) -> Receipt {
        self.receipts().read(&source.name).unwrap()
    }

    pub(crate) fn kept(&self, source: &RunSource) -> Kept {
        self.receipt(source).kept.unwrap()
    }

    /// Pushes a run at a time.
    pub(crate) fn push_at(&self, source: &RunSource, unix_s: f64) -> Result<Outcome, ArchiveError> {
        let receipts = self.receipts();
        let mut pusher = Pusher::of(&self.store, &receipts, self.site);
        let now = Now {
            unix_s,
            ..Now::default()
        };
        block_on(pusher.push(source, &now))
    }

    pub(crate) fn push(&self, source: &RunSource) -> Result<Outcome, ArchiveError> {
        self.push_at(source, 1.0)
    }

    /// All that the store holds, by path.
    pub(crate) fn held(&self) -> BTreeMap<String, Vec<u8>> {
        held(&self.inner)
    }

    /// Holds the store against a run folder: every byte, the list, and rows in one partition.
    pub(crate) fn assert_holds(&self, source: &RunSource) {
        let (held, run) = (self.held(), self.kept(source).placed.run_sha256);
        for (path, bytes) in content(source) {
            let hash = sha256(&bytes);
            let object = &held[&format!("objects/sha256/{}/{hash}", &hash[..2])];
            assert!(*object == bytes, "{path}");
        }
        let list: serde_json::Value =
            serde_json::from_slice(&held[&format!("runs/{run}.json")]).unwrap();
        let listed = list["files"].as_array().unwrap().iter();
        let listed: BTreeMap<&str, &str> = listed
            .map(|file| {
                (
                    file["path"].as_str().unwrap(),
                    file["sha256"].as_str().unwrap(),
                )
            })
            .collect();
        let files = content(source);
        let wanted = files
            .iter()
            .map(|(path, bytes)| (path.as_str(), sha256(bytes)));
        let wanted: BTreeMap<&str, String> = wanted.collect();
        assert_eq!(
            listed,
            wanted
                .iter()
                .map(|(path, hash)| (*path, hash.as_str()))
                .collect()
        );
    }

    /// Paths of the rows in the store.
    pub(crate) fn rows(&self) -> Vec<String> {
        let held = self.held().into_keys();
        held.filter(|path| path.starts_with("tables/")).collect()
    }
}

pub(crate) fn held(store: &InMemory) -> BTreeMap<String, Vec<u8>> {
    block_on(async {
        let listed: Vec<_> = store.list(None).try_collect().await.unwrap();
        let mut held = BTreeMap::new();
        for meta in listed {
            let bytes = store.get(&meta.location).await.unwrap().bytes().await;
            held.insert(meta.location.to_string(), bytes.unwrap().to_vec());
        }
        held
    })
}

pub(crate) fn block_on<T>(future: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = { runtime }.enable_all().build().unwrap();
    runtime.block_on(future)
}

/// Files of a run as they must be in the store.
fn content(source: &RunSource) -> BTreeMap<String, Vec<u8>> {
    let own = files_of(&source.folder).unwrap().into_iter();
    let sums = Some(SUMS.to_owned()).filter(|sums| source.folder.join(sums).exists());
    let own = own.chain(sums).map(|path| {
        let bytes = fs::read(source.folder.join(&path)).unwrap();
        (path, bytes)
    });
    let beside = source.diagnoses.iter().map(|one| {
        let bytes = fs::read(one.folder.join(DIAGNOSIS)).unwrap();
        (format!("analyses/{}/{DIAGNOSIS}", one.name), bytes)
    });
    own.chain(beside).collect()
}

/// A run that is made.
pub(crate) struct Made {
    pub(crate) name: &'static str,
    pub(crate) bench: &'static str,
    /// How it ended; none where it did not.
    pub(crate) how: Option<&'static str>,
    /// Size of its one large capture.
    pub(crate) large: usize,
}

impl Made {
    pub(crate) const ONE: Self = Self {
        name: "one",
        bench: "b1",
        how: Some("finished"),
        large: 100,
    };
    /// The same with a capture that is sent in parts.
    pub(crate) const LARGE: Self = Self {
        large: 6_000_000,
        ..Self::ONE
    };

    /// Writes its folder.
    pub(crate) fn write(&self, place: &Place) -> RunSource {
        let folder = place.runs().join(self.name);
        fs::create_dir_all(folder.join("captures/cell")).unwrap();
        let put = |name: &str, text: &str| fs::write(folder.join(name), text).unwrap();
        put(MANIFEST, &self.manifest());
        put(JOURNAL, &self.journal());
        put(INDEX, &index());
        put(SPECTRUM, &spectrum());
        put(&run_folder::model(1), &model());
        put(
            &run_folder::capture("cell", "point01_1.000000Hz"),
            "codes of a point",
        );
        let large: Vec<u8> = (0..self.large).map(|k| (k * k / 7 % 251) as u8).collect();
        let path = run_folder::capture("cell", "point02_2.000000Hz");
        fs::write(folder.join(path), large).unwrap();
        if self.how == Some("finished") {
            write_sums(&folder);
        }
        RunSource::of(&folder)
    }

    fn manifest(&self) -> String {
        json!({
            "program": "eis-bench", "version": "0.1.0", "experiment": "ageing",
            "bench": self.bench, "cell": { "name": "P45B", "serial": "P45B-17" },
            "seed": 7, "time": "real", "started_unix_s": STARTED_S, "bench_time_s": 100.0,
        })
        .to_string()
    }

    fn journal(&self) -> String {
        let started = json!({ "started": {
            "version": "0.1.0", "experiment": "ageing", "seed": 7, "time": "real",
            "inherited": false, "files": [], "plan": [],
        }});
        let ended = self.how.map(|how| json!({ "ended": { "how": how } }));
        let line = |entry: serde_json::Value| {
            format!("{{\"number\":1,\"time_s\":1.5,\"entry\":{entry},\"sha256\":\"00\"}}\n")
        };
        [Some(started), ended]
            .into_iter()
            .flatten()
            .map(line)
            .collect()
    }
}

fn index() -> String {
    json!({
        "cell": "P45B", "capacity_c": 16200.0, "traces": [],
        "sweeps": [{
            "file": SPECTRUM, "fixture": "cell", "fixture_ohm": null, "corrected": true,
            "amplitude_a": 1.0, "repeat": 1, "order": 0, "start_time_s": 50.0,
            "start_ocv_v": 3.7, "temperature_c": 25.0, "role": "train",
            "repeat_group": "eis", "flagged": [],
        }],
    })
    .to_string()
}

fn spectrum() -> String {
    let head = "freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm,sigma_im_ohm,cov_re_im_ohm2,amplitude_a";
    format!("{head}\n1.0,0.01,-0.002,3e-6,3e-6,0.0,1.0\n2.0,0.009,-0.001,3e-6,3e-6,0.0,1.0\n")
}

fn model() -> String {
    json!({
        "schema": run_folder::MODEL_SCHEMA, "schema_version": 1, "name": "P45B", "rc": 1,
        "fit": {
            "erm": { "r_ohm": 0.006, "branches": [{ "r_ohm": 0.004, "c_f": 10.0 }] },
            "sigma": { "r_ohm": 1e-6, "branches": [{}], "dc_resistance_ohm": 2e-6 },
            "objective": 1.0, "points": 2, "rms_ohm": 3e-6, "reduced_chi2": 1.1,
        },
        "dc_resistance_ohm": 0.01, "time_constants_s": [0.04], "spectra": ["spectrum"],
    })
    .to_string()
}

/// Writes the list of hashes of a folder.
pub(crate) fn write_sums(folder: &Path) {
    let line = |name: String| {
        let bytes = fs::read(folder.join(&name)).unwrap();
        format!("{}  {name}\n", sha256(&bytes))
    };
    let lines: String = files_of(folder).unwrap().into_iter().map(line).collect();
    fs::write(folder.join(SUMS), lines).unwrap();
}

/// A diagnosis beside a run.
pub(crate) fn diagnosed(place: &Place, source: &RunSource, name: &str) -> RunSource {
    // As a server lays them: all have the same last name.
    let name = format!("{name}/out");
    let folder = place.folder.path().join("analyses").join(&name);
    fs::create_dir_all(&folder).unwrap();
    let text = json!({
        "data_set": source.name, "model": "P45B", "verdict": "missing-effect",
        "summary": "the model lacks diffusion",
        "effects": [{ "name": "diffusion", "parameters": [
            { "name": "tau_s", "value": 12.5, "sigma": 0.5, "unit": "s" },
        ]}],
    });
    fs::write(folder.join(DIAGNOSIS), text.to_string()).unwrap();
    RunSource {
        diagnoses: [&source.diagnoses[..], &[DiagnosisFolder { name, folder }]].concat(),
        ..source.clone()
    }
}
