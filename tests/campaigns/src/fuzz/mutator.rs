//! Random changes of seeds.

use std::ops::Range;

use super::LONGEST;
use crate::Random;
use crate::bad_inputs::{NUMBERS, TEXTS};

/// One of the seeds with some changes; now and then a seed as it is.
pub fn input(random: &mut Random, seeds: &[Vec<u8>]) -> Vec<u8> {
    let mut input = seeds[random.count(0, seeds.len())].clone();
    for _ in 0..random.of(&[0, 1, 1, 1, 2, 3, 5, 12]) {
        change(random, &mut input, seeds);
        input.truncate(LONGEST);
    }
    input
}

fn change(random: &mut Random, input: &mut Vec<u8>, seeds: &[Vec<u8>]) {
    let at = random.count(0, input.len() + 1);
    let end = (at + random.of(&[1, 1, 2, 4, 16, 64])).min(input.len());
    match random.count(0, 14) {
        // A bit.
        0 if at < input.len() => input[at] ^= 1 << random.count(0, 8),
        // A byte.
        1 if at < input.len() => input[at] = random.count(0, 256) as u8,
        2 => drop(input.drain(at..end)),
        3 => {
            let copy = input[at..end].to_vec();
            input.splice(at..at, copy);
        }
        4 | 5 => {
            let text = random.of(&TEXTS);
            input.splice(at..at, text.iter().copied());
        }
        6 | 7 => number(random, input, at),
        // A part of another seed.
        8 => {
            let other = &seeds[random.count(0, seeds.len())];
            let from = random.count(0, other.len() + 1);
            let to = (from + random.of(&[4, 32, 256])).min(other.len());
            input.splice(at..end, other[from..to].iter().copied());
        }
        9 => {
            let mut lines: Vec<&[u8]> = input.split_inclusive(|byte| *byte == b'\n').collect();
            if !lines.is_empty() {
                let (one, other) = (random.count(0, lines.len()), random.count(0, lines.len()));
                lines.swap(one, other);
            }
            *input = lines.concat();
        }
        10 => input.truncate(at),
        // A word in the place of another one, as a whole: what is made so is read further than what is cut anywhere.
        11 | 12 => {
            let other = &seeds[random.count(0, seeds.len())];
            let new = word(other, random.count(0, other.len() + 1));
            let old = word(input, at);
            input.splice(old, other[new].iter().copied());
        }
        _ => {
            let byte = random.of(b"[{(\"',;9-. \n\0\xff");
            input.splice(at..at, std::iter::repeat_n(byte, random.of(&[1, 3, 20, 300])));
        }
    }
}

/// The next word after a place.
fn word(text: &[u8], at: usize) -> Range<usize> {
    let is_part = |byte: &u8| byte.is_ascii_alphanumeric() || b"_-.*+".contains(byte);
    let start = text[at..].iter().position(is_part).map_or(text.len(), |start| at + start);
    let end = text[start..].iter().position(|byte| !is_part(byte)).map_or(text.len(), |length| start + length);
    start..end
}

/// Replaces the next number after a place.
fn number(random: &mut Random, input: &mut Vec<u8>, at: usize) {
    let is_part = |byte: &u8| byte.is_ascii_digit() || b"+-.eE".contains(byte);
    let Some(start) = input[at..].iter().position(u8::is_ascii_digit).map(|start| at + start) else { return };
    let end = input[start..].iter().position(|byte| !is_part(byte)).map_or(input.len(), |length| start + length);
    let new = random.of(&NUMBERS);
    input.splice(start..end, new.bytes());
}
