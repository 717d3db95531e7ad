//! A domain: processes of one domain see each other, those of another do not.

use super::{Ipc, MAX_NODES};
use crate::error::{Error, Result};
use iceoryx2::config::Config;
use iceoryx2::node::{NodeState, NodeView};
use iceoryx2::prelude::*;
use iceoryx2::service::Service;
use std::time::Duration;

/// Environment variable that names the domain.
pub const VARIABLE: &str = "EMA_DOMAIN";

/// Longest name of a domain.
const LONGEST: usize = 32;

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
    pub fn new(name: &str) -> Result<Self> {
        quiet();
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-';
        if name.len() > LONGEST || !name.chars().all(allowed) {
            let rule = format!("up to {LONGEST} letters, digits and -");
            return Err(Error::bad("command line", "domain", name, rule));
        }
        let mut config = Config::global_config().clone();
        if !name.is_empty() {
            let prefix = format!("{name}_");
            config.global.prefix = FileName::new(prefix.as_bytes()).map_err(|e| failed(name, "no domain", e))?;
        }
        Ok(Self { config })
    }

    /// The domain that `EMA_DOMAIN` names, or the default.
    pub fn from_environment() -> Result<Self> {
        Self::new(&std::env::var(VARIABLE).unwrap_or_default())
    }

    /// Prefix of this domain's files in shared memory.
    pub fn prefix(&self) -> String {
        self.config.global.prefix.to_string()
    }

    /// A node of this process. What dead processes left behind is removed first.
    pub fn node(&self) -> Result<Node<Ipc>> {
        let node = NodeBuilder::new()
            .config(&self.config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|e| failed("shared memory", "no node", e))?;
        node.blocking_cleanup_dead_nodes(Duration::from_millis(500));
        Ok(node)
    }

    /// Removes what dead processes of this domain left in shared memory.
    pub fn clean(&self) {
        let mut dead = Vec::new();
        let _ = Node::<Ipc>::list(&self.config, |state| {
            if let NodeState::Dead(view) = state {
                dead.push(view);
            }
            CallbackProgression::Continue
        });
        for view in dead {
            let _ = view.try_remove_stale_resources();
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

    /// The event service of a name.
    pub(super) fn events(
        &self,
        node: &Node<Ipc>,
        service: &str,
    ) -> Result<iceoryx2::service::port_factory::event::PortFactory<Ipc>> {
        let name = service.try_into().expect("a valid name");
        node.service_builder(&name)
            .event()
            .max_nodes(MAX_NODES)
            .max_listeners(MAX_EVENT_PORTS)
            .max_notifiers(MAX_EVENT_PORTS)
            .open_or_create()
            .map_err(|e| failed(service, "event service cannot be opened", e))
    }

    /// Why a publish-subscribe service was refused: where another layout stands behind it, both
    /// are named.
    pub(super) fn refused(&self, service: &str, wanted: &str, why: &dyn std::fmt::Debug) -> Error {
        let name = service.try_into().expect("a valid name");
        let details = Ipc::details(&name, &self.config, MessagingPattern::PublishSubscribe);
        if let Ok(Some(d)) = details {
            let types = d.static_details.publish_subscribe().message_type_details();
            let (header, payload) = (types.user_header.type_name(), types.payload.type_name());
            let found = if header.to_string() == "()" { payload } else { header };
            if found.to_string() != wanted {
                let place = "schema version of those who are connected";
                return Error::bad(service, place, version(&found.to_string()), version(wanted));
            }
        }
        failed(service, "cannot be opened", why)
    }
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
