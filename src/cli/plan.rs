//! `trued plan`: prints the whole plan from nominal positions, as text, JSON or a program.

use std::path::Path;

use super::args::PlanArgs;
use super::artefact::complete_report_data;
use super::failure::CommandFailure;
use super::show;
use crate::setup;
use machine::Axis;
use machine::record::motion::MotionBlock;
use machine::record::plan::{Plan, Sampling, Stage};
use machine::record::stage_proof::StageProof;
use planning::gcode::{Dialect, HeadAndFootValues};
use planning::proof::{ProofRequest, StageSteps, prove_programs};
use planning::{MachineTime, TouchedDirections};

pub fn plan_command(args: &PlanArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let machine = setup::load_machine_file(args.machine.as_deref(), &args.method)?;
    let (method, mut plan_without_steps) =
        setup::configure_method_and_plan_without_steps(&machine, &args.method, None)?;
    plan_without_steps.report = complete_report_data(&machine.report_data, state)?;
    let (plan, stages) = methods::plan_nominal_stages(method.as_ref(), plan_without_steps)?;
    let once: Vec<Stage> = stages.iter().filter(|stage| stage.repeat == 0).cloned().collect();
    if args.json {
        show::print_json(&plan)?;
    } else if let Some(dialect) = &args.gcode {
        let (text, proof) = render_and_prove_program(&plan, &once, dialect)?;
        outln!("{}", text.trim_end_matches('\n'));
        for line in describe_proof(&proof, &plan) {
            errln!("{line}");
        }
        match describe_dwell_sampling(&plan) {
            Some(what) => errln!(
                "this program is for reading only: {what}; another G-code sender takes no samples and does \
                not monitor the range of the sensor"
            ),
            None => errln!(
                "this program is for reading only: another G-code sender does not monitor guarded moves for \
                contact; `trued run` does"
            ),
        }
    } else {
        let machine_s = print_plan_and_return_time_s(&plan, &stages)?;
        for line in method.forecast(&plan, machine_s)? {
            outln!("{line}");
        }
        let (_, proof) = render_and_prove_program(&plan, &once, machine.controller_section.control.dialect())?;
        for line in describe_proof(&proof, &plan) {
            outln!("{line}");
        }
        if !plan.assumed.is_empty() {
            let keys = plan.assumed.join(", ");
            outln!("keys that are missing in the machine file, with assumed values (docs/uncertainty.md): {keys}");
        }
    }
    Ok(())
}

/// The whole program, each step once, and its proof. The start position of the machine is unknown.
fn render_and_prove_program(
    plan: &Plan,
    stages: &[Stage],
    dialect_name: &str,
) -> Result<(String, StageProof), CommandFailure> {
    let dialect =
        Dialect::from_name(dialect_name).and_then(|named| named.with_machine_options(&plan.machine, &plan.probe));
    let dialect = dialect.map_err(|error| CommandFailure::new(&error, error.remedy()))?;
    let (blocks, _) = planning::plan_blocks_and_time_s_by_stage(plan, stages)?;
    let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
    let title = match describe_dwell_sampling(plan) {
        Some(what) => format!("{}, {what}", plan.method),
        None => plan.method.clone(),
    };
    let program = HeadAndFootValues { title: &title, axes: &axes, result_log_path: None };
    let text = render_program_text(&dialect, &program, plan, stages, &blocks)?;
    let staged: Vec<StageSteps> = stages
        .iter()
        .map(|stage| StageSteps { step_ids: &stage.steps, found_artefact: stage.found.as_ref() })
        .collect();
    let request = ProofRequest {
        plan,
        stages: &staged,
        start_position: None,
        touched_directions: TouchedDirections::default(),
        dialect: &dialect,
    };
    let proof = prove_programs(&request, std::slice::from_ref(&text)).map_err(|refusal| {
        CommandFailure::new(format!("the collision check refuses the program: {refusal}"), refusal.remedy())
    })?;
    Ok((text, proof))
}

/// Text of the program stage by stage; before each stage its prompts, each with a stop.
fn render_program_text(
    dialect: &Dialect,
    program: &HeadAndFootValues<'_>,
    plan: &Plan,
    stages: &[Stage],
    blocks: &[MotionBlock],
) -> Result<String, CommandFailure> {
    let mut lines = dialect.render_head(program)?;
    let mut blocks = blocks.iter().peekable();
    for stage in stages {
        let (asked, moves) = planning::split_prompts(plan, &stage.steps)?;
        for (step, text) in asked {
            lines.extend(dialect.render_prompt(step.id, text)?);
        }
        while let Some(block) = blocks.next_if(|block| moves.contains(&block.step)) {
            lines.extend(dialect.render_block(block)?);
        }
    }
    lines.extend(dialect.render_foot(program)?);
    Ok(lines.into_iter().map(|line| line + "\n").collect())
}

/// Description of the first sampling dwell; `None` if the plan has no sampling dwell.
fn describe_dwell_sampling(plan: &Plan) -> Option<String> {
    let scans = plan.steps.iter().filter_map(|step| Some((step, step.scan.as_ref()?.sampling)));
    let mut dwells = scans.filter_map(|(step, sampling)| match sampling {
        Sampling::Dwell { samples, .. } => Some((step, samples)),
        Sampling::Continuous { .. } => None,
    });
    let (step, samples) = dwells.next()?;
    Some(format!("at each G4 dwell trued takes {samples} samples of {}", step.sensors.join(", ")))
}

/// Summary of the proof for the user.
fn describe_proof(proof: &StageProof, plan: &Plan) -> Vec<String> {
    let nearest = proof.nearest.as_ref().map_or(String::new(), |near| {
        let [one, other] = &near.between;
        let label = plan.steps.iter().find(|step| step.id == near.step).map(|step| &step.label);
        format!(
            "; smallest clearance {:.2} mm between {one} and {other}, line {}, step {} ({})",
            near.clearance_mm,
            near.line,
            near.step,
            label.map_or("", String::as_str)
        )
    });
    let mut lines = vec![format!("collision check passed: {} motions{nearest}", proof.motion_count)];
    lines.extend(proof.unchecked_items.iter().map(|what| format!("not checked: {what}")));
    lines
}

/// Prints the plan; returns the machine time of all stages, s.
fn print_plan_and_return_time_s(plan: &Plan, stages: &[Stage]) -> Result<f64, CommandFailure> {
    let (blocks, machine_s) = planning::plan_blocks_and_time_s_by_stage(plan, stages)?;
    outln!("{} on {}: {} steps", plan.method, plan.machine.name, plan.steps.len());
    for step in &plan.steps {
        let turned: Vec<String> = step
            .from
            .iter()
            .filter(|(axis, _)| !axis.is_linear())
            .map(|(axis, value)| format!("{axis}{}", axis.to_mm_or_deg(value)))
            .collect();
        let what = step.text.clone().unwrap_or_else(|| turned.join(" "));
        outln!("  {:>4}  {:<14} {what}", step.id, step.label);
    }
    let seconds = machine_s.round();
    let time = MachineTime::from_blocks(&blocks, &plan.machine);
    let percent = |seconds: f64| 100.0 * seconds / time.total_s().max(f64::MIN_POSITIVE);
    outln!("machine time: about {:.0} min {:.0} s", (seconds / 60.0).floor(), seconds % 60.0);
    outln!(
        "share of touches {:.0} %, travel of X, Y, Z {:.0} %, travel of rotary axes {:.0} %, dwells {:.0} %",
        percent(time.touch_s),
        percent(time.linear_move_s),
        percent(time.rotary_move_s),
        percent(time.dwell_s)
    );
    Ok(machine_s)
}
