//! A domain: processes of one domain see each other, those of another do not.

use super::{Ipc, MAX_NODES};
use crate::error::{Error, Result};
use iceoryx2::config::Config;
use iceoryx2::node::{DeadNodeView, NodeState, NodeView};
use iceoryx2::prelude::*;
use iceoryx2::service::Service;
use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Environment variable that names the domain.
pub const VARIABLE: &str = "EMA_DOMAIN";

/// Longest name of a domain.
const LONGEST: usize = 32;

/// Longest wait for half-made services, and the time between two looks for them.
const MENDING: Duration = Duration::from_secs(5);
const MENDING_EVERY: Duration = Duration::from_millis(500);
/// Least of the numbers that no two makers have: they have more than 20 digits.
const UNIQUE: u128 = 10_u128.pow(20);

/// A node's folder that nothing else has told of for so long is nobody's.
const ORPHANED: Duration = Duration::from_secs(10);

/// Listeners and notifiers of one event service.
const MAX_EVENT_PORTS: usize = 128;

/// An iceoryx2 failure in one line.
pub fn failed(service: &str, what: &str, why: impl std::fmt::Debug) -> Error {
    Error::Stream {
        service: service.into(),
        why: format!("{what} ({why:?})"),
    }
}

/// A domain of shared-memory services: the prefix of everything that iceoryx2 creates.
#[derive(Clone, Debug)]
pub struct Domain {
    config: Config,
}

impl Domain {
    /// * `name` empty for iceoryx2's own default, which programs in other languages use unless told
    ///   otherwise; else letters, digits and `-`
    ///
    /// # Errors
    /// A name that is too long or has other characters.
    pub fn new(name: &str) -> Result<Self> {
        quiet();
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-';
        if name.len() > LONGEST || !name.chars().all(allowed) {
            let rule = format!("up to {LONGEST} letters, digits and -");
            return Err(Error::bad("command line", "domain", name, rule));
        }
        let mut config = Config::global_config().clone();
        // cleaning up is done by `clean`, which first mends what would make it wait for ever
        config.global.service.cleanup_dead_nodes_on_open = false;
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        if !name.is_empty() {
            let prefix = format!("{name}_");
            config.global.prefix = FileName::new(prefix.as_bytes()).map_err(|e| failed(name, "no domain", e))?;
        }
        Ok(Self { config })
    }

    /// The domain that `EMA_DOMAIN` names, or the default.
    ///
    /// # Errors
    /// As [`Domain::new`].
    pub fn from_environment() -> Result<Self> {
        Self::new(&std::env::var(VARIABLE).unwrap_or_default())
    }

    /// Prefix of this domain's files in shared memory.
    pub fn prefix(&self) -> String {
        self.config.global.prefix.to_string()
    }

    /// A node of this process. What dead processes left behind is removed first.
    ///
    /// # Errors
    /// Shared memory that refuses.
    pub fn node(&self) -> Result<Node<Ipc>> {
        self.keep_mending();
        let start = Instant::now();
        while !self.mend() && start.elapsed() < MENDING {
            std::thread::sleep(Duration::from_millis(10));
        }
        self.clean();
        self.sweep();
        NodeBuilder::new()
            .config(&self.config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|e| failed("shared memory", "no node", e))
    }

    /// Removes what dead processes of this domain left in shared memory, unless something is being
    /// made just now.
    pub fn clean(&self) {
        if !self.mend() {
            return;
        }
        let Some((dead, others)) = self.nodes() else { return };
        for view in dead {
            let _ = view.try_remove_stale_resources();
        }
        if others == 0 {
            self.empty();
        }
    }

    /// Nodes of dead processes, and the number of all others.
    fn nodes(&self) -> Option<(Vec<DeadNodeView<Ipc>>, usize)> {
        let (mut dead, mut others) = (Vec::new(), 0);
        let listed = Node::<Ipc>::list(&self.config, |state| {
            match state {
                NodeState::Dead(view) => dead.push(view),
                _ => others += 1,
            }
            CallbackProgression::Continue
        });
        listed.ok().map(|()| (dead, others))
    }

    /// Removes shared memory that has the unique number of its maker's port in its name, if nobody is there: a process that dies while
    /// it makes a port leaves some that its node does not tell of. Names without a number may be somebody's at any time; in iceoryx2's
    /// own domain may be programs whose nodes are listed elsewhere: nothing of that.
    fn empty(&self) {
        if self.config.global.prefix == Config::global_config().global.prefix {
            return;
        }
        let all = self.files_in(Path::new("/dev/shm"));
        let numbered: Vec<PathBuf> = all
            .filter(|e| number_in(&e.file_name().to_string_lossy()).is_some_and(|n| n >= UNIQUE))
            .map(|e| e.path())
            .collect();
        // after they were found: whoever has one of them and lives is in the list
        if !numbered.is_empty() && self.nodes().is_some_and(|(_, others)| others == 0) {
            numbered.iter().for_each(|f| drop(std::fs::remove_file(f)));
        }
    }

    /// What has this domain's prefix in a folder.
    fn files_in(&self, dir: &Path) -> impl Iterator<Item = std::fs::DirEntry> {
        let all = std::fs::read_dir(dir).into_iter().flatten().flatten();
        all.filter(|e| e.file_name().to_string_lossy().starts_with(&self.prefix()))
    }

    /// Removes folders of nodes that died so early, or whose cleaner died so late, that nothing but
    /// the folder tells of them.
    fn sweep(&self) {
        let dir = PathBuf::from(self.config.global.node_dir().to_string());
        let list = |dir: &Path| std::fs::read_dir(dir).into_iter().flatten().flatten();
        let names: Vec<String> = list(&dir)
            .map(|e| e.file_name().to_string_lossy().into_owned())
            .collect();
        for e in list(&dir).filter(|e| e.path().is_dir()) {
            let id = e.file_name().to_string_lossy().into_owned();
            let is_known = names.iter().any(|n| n.contains(&format!("_{id}.")));
            let age = e
                .metadata()
                .and_then(|m| m.modified())
                .ok()
                .and_then(|t| t.elapsed().ok());
            let ours = |e: &std::fs::DirEntry| e.file_name().to_string_lossy().starts_with(&self.prefix());
            let mut files = list(&e.path()).peekable();
            let all_ours = files.peek().is_some() && files.all(|f| ours(&f));
            if !is_known && all_ours && age.is_some_and(|age| age > ORPHANED) {
                let _ = std::fs::remove_dir_all(e.path());
            }
        }
    }

    /// Files of this domain that somebody is making or removing, or has died while at it, and for how long: iceoryx2 gives
    /// shared memory its read permission, and takes a service description's write permission away,
    /// when they are complete. A service's memory is there before its description is complete, and is removed before it.
    fn half_made(&self) -> Vec<(PathBuf, Duration)> {
        const READABLE: u32 = 0o400;
        const WRITABLE: u32 = 0o200;
        let services = self.config.global.service_dir().to_string();
        let (mut found, mut without_memory) = (Vec::new(), BTreeMap::new());
        // memory after the descriptions that tell of it
        for (dir, is_service) in [(services.as_str(), true), ("/dev/shm", false)] {
            for e in self.files_in(Path::new(dir)) {
                let name = e.file_name();
                let name = name.to_string_lossy();
                if name.ends_with(".dynamic")
                    && let Some(number) = number_in(&name)
                {
                    without_memory.remove(&number);
                }
                let Ok(data) = e.metadata() else { continue };
                let mode = data.permissions().mode();
                let complete = if is_service {
                    mode & WRITABLE == 0
                } else {
                    mode & READABLE != 0
                };
                if !complete {
                    let age = data.modified().ok().and_then(|t| t.elapsed().ok());
                    found.push((e.path(), age.unwrap_or_default()));
                } else if is_service && let Some(number) = number_of_service(&e.path()) {
                    without_memory.insert(number, e.path());
                }
            }
        }
        let aged = |(number, path)| (path, seen_for(number));
        found.extend(without_memory.into_iter().map(aged));
        found
    }

    /// Removes what has been half made, or half removed, for longer than that takes: iceoryx2 0.10 waits for its
    /// maker, who is dead, without end. Returns whether nothing half made is left. One process at a
    /// time: who removes an old file must not meet the new one.
    fn mend(&self) -> bool {
        if self.half_made().is_empty() {
            return true;
        }
        let path = format!("{}/{}mending.lock", self.config.global.root_path(), self.prefix());
        let Ok(lock) = std::fs::File::create(path) else {
            return false;
        };
        let _ = lock.lock();
        let timeout = self.config.global.creation_timeout;
        let all = self.half_made();
        for (path, age) in &all {
            if *age >= timeout {
                let _ = std::fs::remove_file(path);
            }
        }
        all.iter().all(|(_, age)| *age >= timeout)
    }

    /// From now on mends this domain now and then, for as long as the process lives: a process may
    /// die in the making while this one waits for it.
    fn keep_mending(&self) {
        static MENDED: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
        let Ok(mut mended) = MENDED.lock() else { return };
        if mended.insert(self.prefix()) {
            let domain = self.clone();
            std::thread::spawn(move || {
                loop {
                    std::thread::sleep(MENDING_EVERY);
                    domain.mend();
                }
            });
        }
    }

    /// Process numbers of the nodes that are alive.
    pub fn processes(&self) -> Vec<u32> {
        let mut alive = Vec::new();
        let _ = Node::<Ipc>::list(&self.config, |state| {
            if let NodeState::Alive(view) = state
                && let Some(details) = view.details()
            {
                alive.push(details.process_id().value() as u32);
            }
            CallbackProgression::Continue
        });
        alive
    }

    /// Opens a service, again if it stood half made because its maker was killed in the middle.
    pub(super) fn open_or_mend<T, E: std::fmt::Debug>(
        &self,
        open: impl Fn() -> std::result::Result<T, E>,
    ) -> std::result::Result<T, E> {
        let start = Instant::now();
        loop {
            let result = open();
            let why = result.as_ref().err().map(|e| format!("{e:?}")).unwrap_or_default();
            let half_made = ["HangsInCreation", "ServiceInCorruptedState", "DoesNotExist"];
            if !half_made.iter().any(|w| why.contains(w)) || start.elapsed() > MENDING {
                return result;
            }
            self.clean();
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// The event service of a name.
    pub(super) fn events(
        &self,
        node: &Node<Ipc>,
        service: &str,
    ) -> Result<iceoryx2::service::port_factory::event::PortFactory<Ipc>> {
        let name = service.try_into().expect("a valid name");
        let open = || {
            node.service_builder(&name)
                .event()
                .max_nodes(MAX_NODES)
                .max_listeners(MAX_EVENT_PORTS)
                .max_notifiers(MAX_EVENT_PORTS)
                .open_or_create()
        };
        self.open_or_mend(open)
            .map_err(|e| failed(service, "event service cannot be opened", e))
    }

    /// Why a publish-subscribe service was refused: where another layout stands behind it, both
    /// are named.
    pub(super) fn refused(&self, service: &str, wanted: &str, why: &dyn std::fmt::Debug) -> Error {
        let name = service.try_into().expect("a valid name");
        let details = Ipc::details(&name, &self.config, MessagingPattern::PublishSubscribe);
        if let Ok(Some(d)) = details {
            let types = d.static_details.publish_subscribe().message_type_details();
            let header = types.user_header.type_name().to_string();
            let found = match header.as_str() {
                "()" => types.payload.type_name().to_string(),
                _ => header,
            };
            if found != wanted {
                let place = "schema version of those who are connected";
                return Error::bad(service, place, version(&found), version(wanted));
            }
        }
        failed(service, "cannot be opened", why)
    }
}

/// Number at the end of a name in shared memory, before its suffix; `None` where there is none.
fn number_in(name: &str) -> Option<u128> {
    let (stem, _) = name.rsplit_once('.')?;
    let (_, number) = stem.rsplit_once('_')?;
    number.parse().ok()
}

/// For how long this process has seen the service of a number without its memory.
fn seen_for(number: u128) -> Duration {
    static SEEN: Mutex<BTreeMap<u128, Instant>> = Mutex::new(BTreeMap::new());
    let seen = SEEN
        .lock()
        .map(|mut seen| seen.entry(number).or_insert_with(Instant::now).elapsed());
    seen.unwrap_or_default()
}

/// Number in the names of a service's shared memory, by its description; `None` where it is not of iceoryx2 0.10.
fn number_of_service(description: &Path) -> Option<u128> {
    let table: toml::Table = std::fs::read_to_string(description).ok()?.parse().ok()?;
    let id = table.get("unique_service_id")?;
    let part = |key: &str| u128::try_from(id.get(key)?.as_integer()?).ok();
    Some((part("unique_value")? << 64) | part("payload_value")?)
}

/// `ema::NAME/VERSION/LAYOUT` for people.
fn version(type_name: &str) -> String {
    let mut parts = type_name.split('/');
    match (parts.next(), parts.next(), parts.next()) {
        (Some(name), Some(version), Some(layout)) if name.starts_with("ema::") => {
            format!("{version} (layout {layout})")
        }
        _ => format!("another type, `{type_name}`"),
    }
}

/// iceoryx2 speaks on standard error only where something is fatal: everything else comes back as
/// an error that says more.
fn quiet() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| set_log_level_from_env_or(LogLevel::Fatal));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbered memory that no node tells of goes once nobody is there; what others may use stays.
    #[test]
    fn memory_of_nobody_is_removed() {
        let name = format!("unit-{}-left", std::process::id());
        let domain = Domain::new(&name).unwrap();
        let shm = |rest: &str| PathBuf::from(format!("/dev/shm/{name}{rest}"));
        let left = shm("_33c1ac61b54bf6edd0a0a8390f0c2fd7cf74d745_158456377198419910168097673810.event_mgmt");
        let others = [
            shm("_33c1ac61b54bf6edd0a0a8390f0c2fd7cf74d745.other"),
            shm("-2_33c1ac61b54bf6edd0a0a8390f0c2fd7cf74d745_158456377198419910168097673810.event_mgmt"),
        ];
        let node = domain.node().unwrap();
        std::fs::write(&left, "x").unwrap();
        others.iter().for_each(|f| std::fs::write(f, "x").unwrap());
        domain.clean();
        assert!(left.exists(), "somebody is there");
        drop(node);
        domain.clean();
        assert!(!left.exists());
        for f in &others {
            assert!(f.exists());
            std::fs::remove_file(f).unwrap();
        }
        let _ = std::fs::remove_file(shm("_9204dd183d1c4d8e1ff592a30766ffa6765aa8b5_node.0_10_0.global_mgmt"));
    }

    /// Who removes a service takes its shared memory first and its description last, and may die in between.
    #[test]
    fn a_service_that_is_half_removed_is_made_anew() {
        let domain = Domain::new(&format!("unit-{}-torn", std::process::id())).unwrap();
        let node = domain.node().unwrap();
        let dynamic = |d: &Domain| -> Vec<PathBuf> {
            let all = d.files_in(Path::new("/dev/shm")).map(|e| e.path());
            all.filter(|p| p.extension().is_some_and(|e| e == "dynamic")).collect()
        };
        let first = domain.events(&node, "torn").unwrap();
        let files = dynamic(&domain);
        assert_eq!(files.len(), 1);
        // one that is whole stays, however long it stands
        std::thread::sleep(domain.config.global.creation_timeout + MENDING_EVERY);
        assert_eq!(dynamic(&domain), files);
        std::fs::remove_file(&files[0]).unwrap();
        let other = domain.node().unwrap();
        let again = domain.events(&other, "torn").unwrap();
        assert_eq!(dynamic(&domain).len(), 1);
        drop((again, first, other, node));
        domain
            .files_in(Path::new("/dev/shm"))
            .for_each(|e| drop(std::fs::remove_file(e.path())));
    }
}
