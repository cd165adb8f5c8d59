//! What the compiler made of the kernels, read from this very program: vector instructions, and no calls among them.
//!
//! A helper that is not inlined is compiled without the instruction set and takes its vectors through memory, at
//! a tenth of the speed. No result shows that, so the machine code is looked at.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::process::Command;

/// Parts of the names of the ways into kernels, and whether there are any.
const ENTRIES: [(&str, bool); 2] =
    [("7Entries4avx2", cfg!(feature = "avx2")), ("7Entries6avx512", cfg!(feature = "avx512"))];

/// Parts of the names of what a kernel may call: it ends the call, fills memory, or asks for a row of it.
const ALLOWED: [&str; 8] = [
    "4core9panicking",
    "4core6option",
    "4core6result",
    "4core5slice5index",
    "len_mismatch_fail",
    "out_of_bounds",
    "memset",
    "prefetch_share",
];

/// Parts of the names of what moves numbers, which a kernel may do at one place, for a whole column. Calls at several places
/// are arrays that an iterator or a function took by value, through memory.
const MOVES: [&str; 2] = ["memcpy", "memmove"];

/// What matters of one function: fused instructions on its vectors, and what it calls.
#[derive(Default)]
struct Function {
    fused: usize,
    calls: Vec<String>,
    /// What registers were loaded with from the table of functions: a call repeated goes through one.
    registers: BTreeMap<String, String>,
}

impl Function {
    fn read(&mut self, name: &str, instruction: &str, slots: &BTreeMap<u64, String>) {
        let register = if name.contains(ENTRIES[1].0) { "%zmm" } else { "%ymm" };
        let (operation, operands) = instruction.split_once(' ').unwrap_or((instruction, ""));
        if operation.starts_with("vf") && operands.contains(register) {
            self.fused += usize::from(operation.ends_with("ps"));
        }
        if let Some((target, register)) = loaded(instruction, slots) {
            self.registers.insert(register, target);
        }
        if operation.starts_with("call") {
            let called = operands.trim().strip_prefix('*').and_then(|r| self.registers.get(r));
            self.calls.push(called.cloned().unwrap_or_else(|| callee(instruction, slots)));
        }
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "nothing is inlined without optimization")]
fn kernels_are_vector_code_without_calls() {
    let Some((relocations, disassembly)) = objdump("-R").zip(objdump("-d")) else {
        println!("skipped: objdump, of binutils, is not installed");
        return;
    };
    let functions = functions(&disassembly, &relocations);
    for (entry, is_compiled) in ENTRIES {
        let entries: Vec<_> = functions.iter().filter(|(name, _)| name.contains(entry)).collect();
        let fused: usize = entries.iter().map(|(_, code)| code.fused).sum();
        assert_eq!(fused > 100, is_compiled, "{entry}: {fused} fused");
        for (name, code) in entries {
            let (moves, calls): (Vec<_>, Vec<_>) =
                code.calls.iter().partition(|callee| contains_any(callee, &MOVES));
            // without arithmetic it only brings a weight to kernel order, once a weight
            let is_codelet = code.fused > 0;
            assert!(!is_codelet || moves.len() <= 1, "{name} calls {moves:?}");
            let calls: Vec<_> =
                calls.iter().filter(|callee| !contains_any(callee, &ALLOWED)).collect();
            assert!(calls.is_empty(), "{name} calls {calls:?}");
        }
    }
}

fn contains_any(name: &str, parts: &[&str]) -> bool {
    parts.iter().any(|part| name.contains(part))
}

/// What objdump says of this program; nothing where there is no objdump.
fn objdump(flag: &str) -> Option<String> {
    let program = std::env::current_exe().unwrap();
    let done =
        match Command::new("objdump").args([flag, "--no-show-raw-insn"]).arg(program).output() {
            Err(error) if error.kind() == ErrorKind::NotFound => return None,
            done => done.unwrap(),
        };
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    Some(String::from_utf8_lossy(&done.stdout).into_owned())
}

/// The functions of a disassembly by name; names of what they call through the table that `relocations` fills.
fn functions(disassembly: &str, relocations: &str) -> BTreeMap<String, Function> {
    let names: BTreeMap<u64, &str> = disassembly.lines().filter_map(heading).collect();
    let slots: BTreeMap<u64, String> =
        relocations.lines().filter_map(|line| slot(line, &names)).collect();
    let mut functions = BTreeMap::<String, Function>::new();
    let mut current = Function::default();
    let mut name = "";
    for line in disassembly.lines().chain(["0 <>:"]) {
        if let Some((_, next)) = heading(line) {
            functions.insert(name.to_owned(), std::mem::take(&mut current));
            name = next;
        } else if let Some((_, instruction)) = line.split_once('\t') {
            current.read(name, instruction, &slots);
        }
    }
    functions
}

/// Address and name of `0000000000045a10 <name>:`.
fn heading(line: &str) -> Option<(u64, &str)> {
    let (address, name) = line.strip_suffix(">:")?.split_once(" <")?;
    Some((u64::from_str_radix(address, 16).ok()?, name))
}

/// Address and name of a slot in the table, from `00000000004d1f28 R_X86_64_RELATIVE  *ABS*+0x45a10` or from a line with a name.
fn slot(line: &str, names: &BTreeMap<u64, &str>) -> Option<(u64, String)> {
    let mut words = line.split_whitespace();
    let address = u64::from_str_radix(words.next()?, 16).ok()?;
    let value = words.nth(1)?;
    let name = match value.strip_prefix("*ABS*+0x") {
        Some(target) => *names.get(&u64::from_str_radix(target, 16).ok()?)?,
        None => value,
    };
    Some((address, name.to_owned()))
}

/// The function and the register of `mov 0x4eb1bd(%rip),%rbx  # 6ecad8 <memcpy>`.
fn loaded(instruction: &str, slots: &BTreeMap<u64, String>) -> Option<(String, String)> {
    let (load, comment) = instruction.split_once("# ")?;
    let register = load.strip_prefix("mov ")?.trim().rsplit_once(',')?.1;
    let address = u64::from_str_radix(comment.split_whitespace().next()?, 16).ok()?;
    Some((slots.get(&address)?.clone(), register.to_owned()))
}

/// The name of what is called: directly, or through the slot whose address stands behind `#`; else the instruction.
fn callee(instruction: &str, slots: &BTreeMap<u64, String>) -> String {
    let indirect = instruction.split_once("# ").and_then(|(_, comment)| {
        let address = comment.split_whitespace().next()?;
        slots.get(&u64::from_str_radix(address, 16).ok()?).cloned()
    });
    let direct = instruction.split_once('<').map(|(_, name)| name.trim_end_matches('>').to_owned());
    indirect.or(direct).unwrap_or_else(|| instruction.to_owned())
}
