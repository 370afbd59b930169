//! `trued plan`: prints the whole plan from nominal positions, as text, JSON or a program.

use super::Exit;
use super::args::PlanArgs;
use super::failure::Failure;
use super::show;
use crate::setup;
use machine::Axis;
use machine::record::motion::Block;
use machine::record::plan::{Plan, Sampling, Stage};
use machine::record::proof::Proof;
use planning::gcode::{Dialect, Program};
use planning::proof::{Request, Staged, prove};
use planning::{Confirmed, MachineTime};

pub fn plan(args: &PlanArgs) -> Result<Exit, Failure> {
    let machine = setup::load(args.machine.as_deref(), &args.method)?;
    let (method, header) = setup::header(&machine, &args.method, None)?;
    let (plan, stages) = methods::nominal(method.as_ref(), header)?;
    let once: Vec<Stage> = stages.iter().filter(|stage| stage.repeat == 0).cloned().collect();
    if args.json {
        show::print_json(&plan)?;
    } else if let Some(dialect) = &args.gcode {
        let (text, proof) = program(&plan, &once, dialect)?;
        say!("{}", text.trim_end_matches('\n'));
        for line in summary(&proof, &plan) {
            tell!("{line}");
        }
        match at_dwells(&plan) {
            Some(what) => tell!(
                "for reading: {what}; a plain sender takes none, and does not watch the sensor's range"
            ),
            None => tell!(
                "for reading: a plain sender does not look at contacts on guarded moves; `trued run` does"
            ),
        }
    } else {
        let machine_s = describe(&plan, &stages)?;
        for line in method.forecast(&plan, machine_s)? {
            say!("{line}");
        }
        let (_, proof) = program(&plan, &once, machine.controller.control.dialect())?;
        for line in summary(&proof, &plan) {
            say!("{line}");
        }
        if !plan.assumed.is_empty() {
            let keys = plan.assumed.join(", ");
            say!("not stated in the machine file and assumed (docs/uncertainty.md): {keys}");
        }
    }
    Ok(Exit::Pass)
}

/// The whole program, each step once, and its proof. The start position of the machine is unknown.
fn program(plan: &Plan, stages: &[Stage], name: &str) -> Result<(String, Proof), Failure> {
    let dialect = Dialect::named(name).and_then(|named| named.with(&plan.machine, &plan.probe));
    let dialect = dialect.map_err(|error| Failure::new(&error, error.remedy()))?;
    let (blocks, _) = planning::staged_blocks(plan, stages)?;
    let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
    let title = match at_dwells(plan) {
        Some(what) => format!("{}, {what}", plan.method),
        None => plan.method.clone(),
    };
    let program = Program { title: &title, axes: &axes, log: None };
    let text = written(&dialect, &program, plan, stages, &blocks)?;
    let staged: Vec<Staged> = stages
        .iter()
        .map(|stage| Staged { steps: &stage.steps, found: stage.found.as_ref() })
        .collect();
    let (stages, stands, confirmed) = (&staged, None, Confirmed::default());
    let programs = std::slice::from_ref(&text);
    let request = Request { plan, stages, stands, confirmed, dialect: &dialect, programs };
    let proof = prove(&request)
        .map_err(|refusal| Failure::new(format!("not proven: {refusal}"), refusal.remedy()))?;
    Ok((text, proof))
}

/// Text of the program stage by stage; before each stage its prompts, each with a stop.
fn written(
    dialect: &Dialect,
    program: &Program<'_>,
    plan: &Plan,
    stages: &[Stage],
    blocks: &[Block],
) -> Result<String, Failure> {
    let mut lines = dialect.head(program)?;
    let mut blocks = blocks.iter().peekable();
    for stage in stages {
        let (asked, moves) = planning::asked_first(plan, &stage.steps)?;
        for (step, text) in asked {
            lines.extend(dialect.ask(step.id, text)?);
        }
        while let Some(block) = blocks.next_if(|block| moves.contains(&block.step)) {
            lines.extend(dialect.block(block)?);
        }
    }
    lines.extend(dialect.foot(program)?);
    Ok(lines.into_iter().map(|line| line + "\n").collect())
}

/// Description of the sampling during dwells, if the plan has any.
fn at_dwells(plan: &Plan) -> Option<String> {
    let scans = plan.steps.iter().filter_map(|step| Some((step, step.scan.as_ref()?.sampling)));
    let mut dwells = scans.filter_map(|(step, sampling)| match sampling {
        Sampling::Dwell { samples, .. } => Some((step, samples)),
        Sampling::Continuous { .. } => None,
    });
    let (step, samples) = dwells.next()?;
    Some(format!("at each G4 trued takes {samples} samples of {}", step.sensors.join(", ")))
}

/// Summary of the proof for the user.
fn summary(proof: &Proof, plan: &Plan) -> Vec<String> {
    let nearest = proof.nearest.as_ref().map_or(String::new(), |near| {
        let [one, other] = &near.between;
        let label = plan.steps.iter().find(|step| step.id == near.step).map(|step| &step.label);
        format!(
            "; nothing comes nearer than {:.2} mm: {one} and {other}, line {}, step {} ({})",
            near.clearance_mm,
            near.line,
            near.step,
            label.map_or("", String::as_str)
        )
    });
    let mut lines = vec![format!("proven: {} motions{nearest}", proof.motions)];
    lines.extend(proof.not_looked_at.iter().map(|what| format!("not looked at: {what}")));
    lines
}

/// Prints the plan; returns the machine time of all stages, s.
fn describe(plan: &Plan, stages: &[Stage]) -> Result<f64, Failure> {
    let (blocks, machine_s) = planning::staged_blocks(plan, stages)?;
    say!("{} on {}: {} steps", plan.method, plan.machine.name, plan.steps.len());
    for step in &plan.steps {
        let turned: Vec<String> = step
            .from
            .iter()
            .filter(|(axis, _)| !axis.is_linear())
            .map(|(axis, value)| format!("{axis}{}", axis.to_edge(value)))
            .collect();
        let what = step.text.clone().unwrap_or_else(|| turned.join(" "));
        say!("  {:>4}  {:<14} {what}", step.id, step.label);
    }
    let seconds = machine_s.round();
    let time = MachineTime::of(&blocks, &plan.machine);
    let percent = |seconds: f64| 100.0 * seconds / time.total_s().max(f64::MIN_POSITIVE);
    say!("machine time about {:.0} min {:.0} s", (seconds / 60.0).floor(), seconds % 60.0);
    say!(
        "of it touches {:.0} %, ways of X, Y, Z {:.0} %, rotary axes {:.0} %, dwells {:.0} %",
        percent(time.touch_s),
        percent(time.way_s),
        percent(time.rotary_s),
        percent(time.rest_s)
    );
    Ok(machine_s)
}
