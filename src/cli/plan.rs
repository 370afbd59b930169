//! `trued plan`: the whole plan from nominal positions, as words, JSON or a program.

use super::Exit;
use super::args::PlanArgs;
use super::failure::Failure;
use super::show;
use crate::base::Axis;
use crate::gcode::{Dialect, Program};
use crate::planning::{self, Clearance};
use crate::record::plan::Plan;
use crate::setup;

pub fn plan(args: &PlanArgs) -> Result<Exit, Failure> {
    let machine = setup::load(args.machine.as_deref())?;
    let (method, header) = setup::header(&machine, &args.method, None)?;
    let plan = nominal(method.as_ref(), header)?;
    if args.json {
        show::print_json(&plan)?;
    } else if let Some(dialect) = &args.gcode {
        print!("{}", program(&plan, dialect)?);
        eprintln!(
            "for reading: a plain sender does not look at contacts on guarded moves; `trued run` does"
        );
    } else {
        describe(&plan)?;
    }
    Ok(Exit::Pass)
}

/// The plan with every stage resolved from nominal positions.
pub fn nominal(
    method: &dyn crate::methods::Method,
    mut plan: Plan,
) -> Result<Plan, crate::methods::Refused> {
    use crate::methods::{Next, Source};
    let mut done = Vec::new();
    while let Next::Stage { stage, new_steps } = method.next(&plan, &done, Source::Nominal)? {
        plan.steps.extend(new_steps);
        done.push(stage);
    }
    Ok(plan)
}

fn program(plan: &Plan, name: &str) -> Result<String, Failure> {
    let dialect = Dialect::named(name).and_then(|named| named.with(&plan.machine, &plan.probe));
    let dialect = dialect.map_err(|error| Failure::new(&error, error.remedy()))?;
    let (blocks, _) = planning::blocks(plan, &Clearance::above(plan)?)?;
    let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
    let program = Program { title: &plan.method, axes: &axes, log: None };
    let text = dialect.program(&program, &blocks)?;
    dialect.proves(&text, &blocks).map_err(Failure::plain)?;
    Ok(text)
}

fn describe(plan: &Plan) -> Result<(), Failure> {
    let (_, seconds) = planning::blocks(plan, &Clearance::above(plan)?)?;
    println!("{} on {}: {} steps", plan.method, plan.machine.name, plan.steps.len());
    for step in &plan.steps {
        let turned: Vec<String> = step
            .from
            .iter()
            .filter(|(axis, _)| !axis.is_linear())
            .map(|(axis, value)| format!("{axis}{}", axis.to_edge(value)))
            .collect();
        println!("  {:>4}  {:<14} {}", step.id, step.label, turned.join(" "));
    }
    println!("machine time about {:.0} min {:.0} s", (seconds / 60.0).floor(), seconds % 60.0);
    Ok(())
}
