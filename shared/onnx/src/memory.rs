//! Whether there is memory enough for a network: the kernel would end the process in the middle of its loading
//! without a word.

/// Bytes that this process may still take: what the machine has available, within the limits of its control group and
/// of its address space. None where nothing says it.
pub(crate) fn available() -> Option<u64> {
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let machine = read("/proc/meminfo").and_then(|text| kib_of(&text, "MemAvailable:"));
    let group = read("/proc/self/cgroup").and_then(|text| of_group(&text, &read));
    let address_space = read("/proc/self/limits")
        .and_then(|text| limit_of(&text, "Max address space"))
        .zip(read("/proc/self/status").and_then(|text| kib_of(&text, "VmSize:")))
        .map(|(most, current)| most.saturating_sub(current));
    [machine, group, address_space].into_iter().flatten().min()
}

/// What a control group (version 2) leaves: its limit less what it holds, but for files that it only keeps at hand.
fn of_group(membership: &str, read: &dyn Fn(&str) -> Option<String>) -> Option<u64> {
    let group = membership.lines().find_map(|line| line.strip_prefix("0::"))?;
    let file = |name: &str| read(&format!("/sys/fs/cgroup{}/{name}", group.trim_end_matches('/')));
    let number = |name: &str| file(name)?.trim().parse::<u64>().ok();
    let (most, current) = number("memory.max").zip(number("memory.current"))?;
    let stat = file("memory.stat").unwrap_or_default();
    let idle = stat
        .lines()
        .find_map(|line| line.strip_prefix("inactive_file ")?.trim().parse::<u64>().ok());
    Some(most.saturating_sub(current.saturating_sub(idle.unwrap_or(0))))
}

/// The bytes of a line such as `MemAvailable:   1234 kB`.
fn kib_of(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    kib.checked_mul(1024)
}

/// The soft limit in bytes of a line such as `Max address space   unlimited   unlimited   bytes`.
fn limit_of(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse().ok()
}

/// What loading a network of this file takes, about: the file, its weights as the kernels want them, and some room for
/// what is computed. Networks on large images take more.
pub(crate) fn needed(file_bytes: u64) -> u64 {
    const WORKING: u64 = 64 << 20;
    file_bytes.saturating_mul(2).saturating_add(WORKING)
}

/// What to say when a network needs more than there is.
pub(crate) fn check(file_bytes: u64, available: Option<u64>) -> Result<(), String> {
    let needed = needed(file_bytes);
    match available {
        Some(available) if available < needed => Err(format!(
            "loading it takes about {} MiB, and {} MiB of memory are free; end other programs, or leave it out",
            needed >> 20,
            available >> 20
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_network_too_large_for_the_memory_is_refused() {
        assert_eq!(check(10 << 20, Some(84 << 20)), Ok(()));
        assert_eq!(check(10 << 20, None), Ok(()));
        let problem = check(912 << 20, Some(1000 << 20)).unwrap_err();
        assert!(
            problem.contains("takes about 1888 MiB, and 1000 MiB of memory are free"),
            "{problem}"
        );
    }

    #[test]
    fn files_that_a_group_keeps_at_hand_are_free() {
        let read = |path: &str| {
            let text = match path {
                "/sys/fs/cgroup/a/b/memory.max" => "1000\n",
                "/sys/fs/cgroup/a/b/memory.current" => "900\n",
                "/sys/fs/cgroup/a/b/memory.stat" => "anon 100\ninactive_file 700\n",
                "/sys/fs/cgroup/memory.max" => "max\n",
                _ => return None,
            };
            Some(text.to_owned())
        };
        assert_eq!(of_group("0::/a/b\n", &read), Some(800));
        assert_eq!(of_group("0::/\n", &read), None);
        assert_eq!(of_group("5:memory:/x\n", &read), None);
    }

    #[test]
    fn figures_of_the_kernel_are_read() {
        let text = "MemTotal: 10 kB\nMemAvailable:   3 kB\n";
        assert_eq!(kib_of(text, "MemAvailable:"), Some(3072));
        assert_eq!(kib_of("", "MemAvailable:"), None);
        let limits =
            "Max stack size 8388608 unlimited bytes\nMax address space         4096   unlimited  bytes\n";
        assert_eq!(limit_of(limits, "Max address space"), Some(4096));
        assert_eq!(
            limit_of("Max address space unlimited unlimited bytes", "Max address space"),
            None
        );
    }
}
