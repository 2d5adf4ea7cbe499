//! Reduces steps to those that a finding needs: delta debugging, and then simpler calls.

use super::Error;
use crate::step::{Argument, Call, Delivery, Step};
use crate::value::Value;

/// Returns fewer and simpler steps that still fail. `fails` runs steps; after an error, or when it returns `None` because the
/// budget is spent, the best steps found until then are returned.
pub(super) fn minimise(steps: Vec<Step>, mut fails: impl FnMut(&[Step]) -> Result<Option<bool>, Error>) -> Vec<Step> {
    let mut best = steps;
    let mut place = 0;
    let mut goes_on = remove(&mut best, &mut fails);
    while matches!(goes_on, Ok(true)) && place < best.len() {
        goes_on = simplify(&mut best, place, &mut fails);
        place += 1;
    }
    best
}

/// Replaces a step by simpler forms as long as the steps fail. Returns whether budget is left.
fn simplify(
    best: &mut Vec<Step>,
    place: usize,
    fails: &mut impl FnMut(&[Step]) -> Result<Option<bool>, Error>,
) -> Result<bool, Error> {
    'changed: loop {
        // each form has one change, so an accepted form is simplified again
        for simpler in best.get(place).map(simpler).unwrap_or_default() {
            let mut steps = best.clone();
            steps.splice(place..=place, [simpler]);
            match fails(&steps)? {
                Some(true) => {
                    *best = steps;
                    continue 'changed;
                }
                Some(false) => {}
                None => return Ok(false),
            }
        }
        return Ok(true);
    }
}

/// Removes chunks of steps, smaller and smaller ones, as long as the rest fails (ddmin). Returns whether budget is left.
fn remove(best: &mut Vec<Step>, fails: &mut impl FnMut(&[Step]) -> Result<Option<bool>, Error>) -> Result<bool, Error> {
    let mut size = best.len().div_ceil(2);
    while size > 0 {
        let mut at = 0;
        while at < best.len() {
            let end = best.len().min(at + size);
            let mut rest = best.clone();
            rest.drain(at..end);
            let is_smaller = !rest.is_empty();
            match if is_smaller { fails(&rest)? } else { Some(false) } {
                Some(true) => *best = rest,
                Some(false) => at = end,
                None => return Ok(false),
            }
        }
        size /= 2;
    }
    Ok(true)
}

/// Returns simpler forms of a step, each with one change.
fn simpler(step: &Step) -> Vec<Step> {
    let Step::Call(call) = step else { return Vec::new() };
    let mut forms = Vec::new();
    if call.delivery != Delivery::Whole {
        forms.push(Call { delivery: Delivery::Whole, ..call.clone() });
    }
    if call.serial.is_some() || call.is_retry {
        forms.push(Call { serial: None, is_retry: false, ..call.clone() });
    }
    for (place, argument) in call.arguments.iter().enumerate() {
        for value in [Value::Empty, Value::I4(0), Value::text("")] {
            if matches!(argument, Argument::Value(old) if *old != value && old.to_wire().len() > value.to_wire().len())
            {
                let mut simple = call.clone();
                simple.arguments.splice(place..=place, [Argument::Value(value)]);
                forms.push(simple);
            }
        }
    }
    forms.into_iter().map(Step::Call).collect()
}

#[cfg(test)]
mod tests {
    use bcap_core::bcap::FunctionId;

    use super::*;

    fn call(function: i32) -> Step {
        Step::Call(Call::new(FunctionId(function), vec![Argument::Value(Value::text("a long text"))]))
    }

    fn has(steps: &[Step], wanted: i32) -> bool {
        steps.iter().any(|step| matches!(step, Step::Call(call) if call.function == wanted))
    }

    #[test]
    fn only_the_steps_that_a_finding_needs_are_left() {
        let steps: Vec<_> = (1..=40).map(call).collect();
        let mut runs = 0;
        let found = minimise(steps, |steps| {
            runs += 1;
            Ok(Some(has(steps, 7) && has(steps, 31)))
        });
        let simple = |n| Step::Call(Call::new(FunctionId(n), vec![Argument::Value(Value::Empty)]));
        assert_eq!(found, [simple(7), simple(31)]);
        assert!(runs < 60, "{runs}");
    }

    #[test]
    fn without_budget_the_best_steps_so_far_are_returned() {
        let mut budget = 3;
        let found = minimise((1..=40).map(call).collect(), |steps| {
            budget -= 1;
            Ok((budget >= 0).then(|| has(steps, 40)))
        });
        assert!(found.len() < 40 && has(&found, 40), "{found:?}");
    }

    #[test]
    fn after_the_end_of_the_run_the_best_steps_so_far_are_returned() {
        let mut left = 1;
        let found = minimise((1..=40).map(call).collect(), |steps| {
            left -= 1;
            if left >= 0 { Ok(Some(has(steps, 40))) } else { Err(Error::Ended) }
        });
        assert_eq!(found, (21..=40).map(call).collect::<Vec<_>>());
    }
}
