//! How much memory there is.

use sysinfo::{MemoryRefreshKind, System};

/// Memory that a new process could take without pushing others out, in bytes: what the system calls
/// available, or what is left of the limit set for this group of processes (a container), whichever is
/// less. `None` where the system does not say.
#[must_use]
pub fn available_memory() -> Option<u64> {
    let mut system = System::new().ok()?;
    system.refresh_memory_specifics(MemoryRefreshKind::nothing().with_ram());
    let available = match system.available_memory() {
        0 => None,
        bytes => Some(bytes),
    };
    let group = system.cgroup_limits().map(|limits| limits.free_memory);
    available.into_iter().chain(group).min()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_some_memory_for_this_test() {
        if let Some(bytes) = available_memory() {
            assert!(bytes > 1 << 20, "{bytes}");
        }
    }
}
