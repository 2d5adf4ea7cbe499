//! The base of a freestanding program for x86-64 Linux: an entry point, a panic handler, three system calls and
//! `memcpy`.
//!
//! There is no allocator, no std and no libc. The panic handler ends in [`panicked`], which is in the image exactly when
//! something can panic.
#![no_std]
#![expect(unsafe_code, reason = "system calls, the entry point and memcpy have no safe form")]

pub mod gateway;
pub mod loops;
pub mod slave;

use core::arch::asm;

/// Makes `main: fn() -> i32` the program's entry; its result is the exit code.
#[macro_export]
macro_rules! entry {
    ($main:path) => {
        #[unsafe(no_mangle)]
        extern "C" fn image_main() -> i32 {
            $main()
        }

        #[unsafe(no_mangle)]
        #[unsafe(naked)]
        extern "C" fn _start() -> ! {
            core::arch::naked_asm!(
                "xor ebp, ebp",
                "and rsp, -16",
                "call image_main",
                "mov edi, eax",
                "mov eax, 60",
                "syscall",
                "ud2",
            )
        }
    };
}

fn syscall(number: usize, a: usize, b: usize, c: usize) -> isize {
    let result: isize;
    // SAFETY: read, write and exit touch no memory but the slices that the callers below own.
    unsafe {
        asm!("syscall", inlateout("rax") number => result, in("rdi") a, in("rsi") b, in("rdx") c,
             lateout("rcx") _, lateout("r11") _, options(nostack));
    }
    result
}

/// Fills `buffer` from standard input as far as that goes, and returns the part that was filled.
pub fn read_all(buffer: &mut [u8]) -> &[u8] {
    let mut len = 0;
    while let Some(rest) = buffer.get_mut(len..).filter(|rest| !rest.is_empty()) {
        match syscall(0, 0, rest.as_mut_ptr().addr(), rest.len()) {
            count @ 1.. => len = len.saturating_add(count.unsigned_abs()),
            _ => break,
        }
    }
    buffer.get(..len).unwrap_or_default()
}

/// Writes all of `bytes` to standard output.
pub fn write_all(mut bytes: &[u8]) {
    while !bytes.is_empty() {
        match syscall(1, 1, bytes.as_ptr().addr(), bytes.len()) {
            count @ 1.. => bytes = bytes.get(count.unsigned_abs()..).unwrap_or_default(),
            _ => break,
        }
    }
}

/// Where a panic ends; no image may contain it.
#[unsafe(no_mangle)]
#[inline(never)]
pub extern "C" fn panicked() -> ! {
    loop {
        syscall(60, 101, 0, 0);
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    panicked()
}

/// # Safety
///
/// As of C's `memcpy`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn memcpy(to: *mut u8, from: *const u8, len: usize) -> *mut u8 {
    // SAFETY: the caller says that both hold `len` bytes.
    unsafe { asm!("rep movsb", inout("rcx") len => _, inout("rdi") to => _, inout("rsi") from => _, options(nostack)) };
    to
}

/// # Safety
///
/// As of C's `memmove`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn memmove(to: *mut u8, from: *const u8, len: usize) -> *mut u8 {
    if to.addr().wrapping_sub(from.addr()) >= len {
        // SAFETY: going upwards, no byte is overwritten before it is read.
        return unsafe { memcpy(to, from, len) };
    }
    let (last_to, last_from) = (to.wrapping_add(len).wrapping_sub(1), from.wrapping_add(len).wrapping_sub(1));
    // SAFETY: as above, going downwards; the direction flag is put back.
    unsafe {
        asm!("std", "rep movsb", "cld", inout("rcx") len => _, inout("rdi") last_to => _,
             inout("rsi") last_from => _, options(nostack));
    }
    to
}

/// # Safety
///
/// As of C's `memset`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn memset(to: *mut u8, byte: i32, len: usize) -> *mut u8 {
    // SAFETY: the caller says that `to` holds `len` bytes.
    unsafe { asm!("rep stosb", inout("rcx") len => _, inout("rdi") to => _, in("eax") byte, options(nostack)) };
    to
}

/// # Safety
///
/// As of C's `memcmp`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn memcmp(a: *const u8, b: *const u8, len: usize) -> i32 {
    for at in 0..len {
        // SAFETY: the caller says that both hold `len` bytes; volatile, or the loop becomes a call of itself.
        let (x, y) = unsafe { (a.wrapping_add(at).read_volatile(), b.wrapping_add(at).read_volatile()) };
        if x != y {
            return i32::from(x).wrapping_sub(i32::from(y));
        }
    }
    0
}

/// # Safety
///
/// As of C's `bcmp`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcmp(a: *const u8, b: *const u8, len: usize) -> i32 {
    // SAFETY: the same promise.
    unsafe { memcmp(a, b, len) }
}

/// Copies what fits from one end to the other, and returns how much that was.
pub fn carry(from: &[u8], to: &mut [u8]) -> usize {
    let count = from.len().min(to.len());
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
    count
}
