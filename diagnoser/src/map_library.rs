//! Which maps a test needs, and where saved ones are found.

use crate::calibration::{COVERAGE, Calibration};
use crate::diagnosis::{Diagnoser, Known};
use crate::failure_map::{FailureMapSet, MapSetHeader};
use schemas::error::{Error, Result};
use schemas::test_kind::TestKind;
use sim_worker::spread::Spread;
use std::f64::consts::TAU;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};

/// Rest angles come in counts of a 16 bit resolver.
const COUNTS: f64 = 65_536.0;

/// The nearest resolver count, in `0..2 pi` [rad].
pub fn rounded_rest_angle(angle_rad: f64) -> f64 {
    let count = (angle_rad / (TAU / COUNTS)).round().rem_euclid(COUNTS);
    count * (TAU / COUNTS)
}

/// What maps must be made for to serve a test: its kind, the rest angle on a resolver count, whatever the load; and the
/// unit, where one is known.
#[derive(Clone, Debug)]
pub struct MapKey(TestKind, Option<String>);

impl MapKey {
    /// The key of a test's maps.
    pub fn new(test: TestKind) -> Self {
        let kind = TestKind {
            rest_angle_rad: rounded_rest_angle(test.rest_angle_rad),
            load_n_m: None,
            ..test
        };
        Self(kind, None)
    }

    /// The key of a test of a unit that is known.
    ///
    /// * `test` of the unit's own model
    /// * `unit` its name
    pub fn of_unit(test: TestKind, unit: &str) -> Self {
        Self(Self::new(test).0, Some(unit.into()))
    }

    /// The unit that was tested, where one is known.
    pub fn unit(&self) -> Option<&str> {
        self.1.as_deref()
    }

    /// The tests that maps are wanted for; no load is named.
    pub fn kind(&self) -> &TestKind {
        &self.0
    }

    /// Whether maps with this header serve.
    pub fn is_served_by(&self, h: &MapSetHeader) -> bool {
        self.0.difference(&h.kind).is_none()
    }

    /// In words, for those who have to make them.
    pub fn describe(&self) -> String {
        self.0.describe()
    }
}

impl PartialEq for MapKey {
    fn eq(&self, other: &Self) -> bool {
        self.0.bits() == other.0.bits() && self.1 == other.1
    }
}

impl Eq for MapKey {}

impl Hash for MapKey {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.0.bits().hash(state);
        self.1.hash(state);
    }
}

/// A coverage that intervals can have.
///
/// # Errors
/// Refuses one that is not above 0 and below 1.
pub fn checked_coverage(coverage: f64) -> Result<f64> {
    if coverage > 0.0 && coverage < 1.0 {
        return Ok(coverage);
    }
    Err(Error::bad(
        "command line",
        "--coverage",
        coverage,
        "above 0 and below 1",
    ))
}

/// What intervals are to be made for.
#[derive(Clone, Debug)]
pub struct Choice {
    /// from unit to unit
    pub spread: Spread,
    /// share of tests whose true pair the intervals are to hold, above 0 and below 1
    pub coverage: f64,
}

impl Choice {
    /// One unit, whose parameters are known; 95 %.
    pub fn usual() -> Self {
        Self {
            spread: Spread::none(),
            coverage: COVERAGE,
        }
    }

    /// * `coverage` share of tests whose true pair the intervals are to hold
    ///
    /// # Errors
    /// Refuses a coverage that is not above 0 and below 1.
    pub fn new(spread: Spread, coverage: f64) -> Result<Self> {
        Ok(Self {
            spread,
            coverage: checked_coverage(coverage)?,
        })
    }

    /// File of the calibration beside maps.
    pub fn calibration_file(&self, maps: &Path) -> PathBuf {
        maps.with_file_name(Calibration::file_name(&self.spread.name))
    }

    /// The calibration beside maps, if there is one.
    ///
    /// # Errors
    /// Refuses a calibration that is torn, of other maps or of other half-widths.
    pub fn calibration(&self, maps: &Path, set: &FailureMapSet) -> Result<Option<Calibration>> {
        let file = self.calibration_file(maps);
        if !file.exists() {
            return Ok(None);
        }
        let c = Calibration::load(&file, &set.fingerprint())?;
        if c.half_width != self.spread.half_width {
            let (found, allowed) = (c.spread().fingerprint(), self.spread.fingerprint());
            let place = format!("half-widths of spread `{}`", self.spread.name);
            return Err(Error::bad(file.display().to_string(), place, found, allowed));
        }
        Ok(Some(c))
    }

    /// Maps with the calibration beside them. Without one, maps of one known unit have uncalibrated
    /// bands.
    ///
    /// # Errors
    /// Refuses as [`Choice::calibration`] and [`Diagnoser::new`] do, and a fleet without calibration.
    pub fn ready(&self, maps: &Path, set: FailureMapSet, known: &Known) -> Result<Diagnoser> {
        let calibration = self.calibration(maps, &set)?;
        if calibration.is_none() && !self.spread.is_none() {
            let folder = maps.parent().unwrap_or(maps).display();
            let file = self.calibration_file(maps).display().to_string();
            let allowed = format!("a calibration: ema calibrate {folder} --spread {}", self.spread.name);
            return Err(Error::bad(file, "file", "nothing", allowed));
        }
        Diagnoser::new(set, calibration, self.coverage, known)
    }
}

/// Name of a file of maps in its folder.
pub const FILE: &str = "maps.parquet";

/// The maps that a place means: those in the folder, or the file itself.
pub fn file_in(place: &Path) -> PathBuf {
    if place.is_dir() { place.join(FILE) } else { place.into() }
}

/// Where maps are to be written: the file itself where it is named as one (`.parquet`), else in the folder.
pub fn file_for(place: &Path) -> PathBuf {
    if place.extension().is_some_and(|e| e == "parquet") {
        place.into()
    } else {
        place.join(FILE)
    }
}

/// Saved map sets in folders.
#[derive(Clone, Debug)]
pub struct MapLibrary {
    /// with what they are for, so that only maps that serve are read again
    files: Vec<(PathBuf, MapSetHeader)>,
    folders: Vec<PathBuf>,
}

impl MapLibrary {
    /// * `places` files, folders with `maps.parquet`, or folders of such folders
    ///
    /// # Errors
    /// Refuses a place without maps that can be loaded.
    pub fn open(places: &[PathBuf]) -> Result<Self> {
        let mut files = Vec::new();
        for place in places {
            let mut found = Self::files_in(place);
            if found.len() > 1 {
                // among many, those that cannot be used are passed over
                found.retain(|f| FailureMapSet::load(f).is_ok());
            }
            if found.is_empty() {
                let allowed = "maps.parquet, a folder that holds it, or a folder of such folders";
                return Err(Error::bad(place.display().to_string(), "maps", "none", allowed));
            }
            for f in found {
                let header = FailureMapSet::load(&f)?.header;
                files.push((f, header));
            }
        }
        Ok(Self {
            files,
            folders: Vec::new(),
        })
    }

    /// A cache folder: looked into anew whenever maps are needed; what cannot be loaded is passed
    /// over.
    pub fn cache(folder: &Path) -> Self {
        Self {
            files: Vec::new(),
            folders: vec![folder.into()],
        }
    }

    fn files_in(place: &Path) -> Vec<PathBuf> {
        if place.is_file() {
            return vec![place.into()];
        }
        let own = place.join(FILE);
        if own.is_file() {
            return vec![own];
        }
        let entries = std::fs::read_dir(place).into_iter().flatten().flatten();
        let mut files: Vec<PathBuf> = entries.map(|e| e.path().join(FILE)).filter(|f| f.is_file()).collect();
        // the latest first: a cache may hold those of earlier versions of the program
        let written = |f: &PathBuf| f.metadata().and_then(|m| m.modified()).ok();
        files.sort_by_cached_key(|f| (std::cmp::Reverse(written(f)), f.clone()));
        files
    }

    /// The first maps that serve, made ready with the calibration beside them.
    pub fn diagnoser(&self, key: &MapKey, choice: &Choice) -> Option<Result<Diagnoser>> {
        let (file, set) = self.find(key)?;
        Some(choice.ready(&file, set, &Vec::new()))
    }

    /// The first maps that serve, and their file.
    pub fn find(&self, key: &MapKey) -> Option<(PathBuf, FailureMapSet)> {
        let serving = self
            .files
            .iter()
            .filter(|(_, h)| key.is_served_by(h))
            .map(|(f, _)| f.clone());
        let cached = self.folders.iter().flat_map(|f| Self::files_in(f));
        serving
            .chain(cached)
            .filter_map(|f| FailureMapSet::load(&f).ok().map(|set| (f, set)))
            .find(|(_, set)| key.is_served_by(&set.header))
    }
}
