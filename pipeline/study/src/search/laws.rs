//! A model's effects by another law of their kind, where a scan cannot tell which: all is solved for again, and the better one stands.

use crate::candidates::bristles::{STATIC, breaks_away};
use crate::candidates::shapes;
use crate::candidates::springs::BY_TORQUE;
use crate::measured::sums::dot;
use crate::search::fit::{Fit, Regressor, Term};
use crate::search::needed::{CERTAIN, penalised};
use crate::search::select::Material;
use sim_worker::effect::{EffectKind, Equation};

impl Material {
    /// A model with each law that another stands for and that tells the data better.
    pub(super) fn by_other_laws(&self, model: Fit) -> Fit {
        self.by_break_away(self.by_another_iron(self.by_play_alone(self.by_motion(model))))
    }

    /// A model whose load runs on by itself in its play, with one that never does unless that is certain: a load that no fit run lets go
    /// would be let go by another.
    fn by_play_alone(&self, model: Fit) -> Fit {
        let alone = |t: &mut Term| {
            let runs_on = t.kind == EffectKind::Backlash && t.shape.len() > 1;
            if runs_on {
                t.shape.truncate(1);
            }
            runs_on
        };
        self.unless_worse(model, CERTAIN, alone)
    }

    /// A model whose springs were found by the torque, with these driven by the measured motion where that tells the data better: the
    /// motion is known better near a resonance, but its noise would have been taken for a spring where there is none.
    fn by_motion(&self, model: Fit) -> Fit {
        let driven = |t: &mut Term| {
            let by_torque = t.kind == EffectKind::Compliance && t.shape.get(3) == Some(&BY_TORQUE);
            if by_torque {
                t.shape[3] = 0.0;
            }
            by_torque
        };
        let torque = |f: &Fit| f.score.energy[Equation::Torque.index()];
        let by_motion = self.if_better(model.clone(), driven);
        // where the torque is on time, two sensors that then agree better on the motion are no reason by themselves
        if self.fit.on_time() && torque(&by_motion) > torque(&model) {
            return model;
        }
        by_motion
    }

    /// A model whose torque saturates, with a flux that does (without phases: by the square of the current) where that tells the
    /// data better. A scan sees little of the difference: constants turn with the loss of torque, and only where all are solved for again do weak currents say whether they lose any.
    fn by_another_iron(&self, model: Fit) -> Fit {
        let other = self.other_iron();
        let saturated = |t: &mut Term| {
            let by_torque = t.kind == EffectKind::TorqueSaturation && t.shape.is_empty();
            if by_torque {
                t.shape = other.clone();
            }
            by_torque
        };
        self.if_better(model, saturated)
    }

    /// Shape of a saturation that is not by the torque.
    fn other_iron(&self) -> Vec<f64> {
        let runs = &self.fit.signals;
        if runs.iter().all(|s| s.phases.is_some()) {
            vec![shapes::strongest(runs)]
        } else {
            shapes::SQUARE.to_vec()
        }
    }

    /// A model whose torque saturates, with the other law of it: which it is may show only beside what else takes torque. `None`
    /// where it does not saturate.
    pub(super) fn of_another_iron(&self, model: &Fit) -> Option<Fit> {
        let (other, by_torque) = (self.other_iron(), Vec::new());
        self.changed(model, |t| {
            let saturates = t.kind == EffectKind::TorqueSaturation;
            if saturates {
                t.shape = if t.shape.is_empty() { &other } else { &by_torque }.clone();
            }
            saturates
        })
    }

    /// A model whose bristles slide at the dynamic friction, with those that break away at the actuator's static one where that tells
    /// the data better.
    fn by_break_away(&self, model: Fit) -> Fit {
        if self.bench.rig.break_away <= 1.0 {
            return model;
        }
        let static_too = |t: &mut Term| {
            let dynamic = t.kind == EffectKind::Presliding && !breaks_away(&t.shape);
            if dynamic {
                t.shape.push(STATIC);
            }
            dynamic
        };
        self.if_better(model, static_too)
    }

    /// A model whose supply's sag is that of a voltage as it was asked for, with that of one that was measured, or back: which it is may
    /// show only beside what else changes the voltage. `None` where the supply is not seen.
    pub(super) fn of_the_other_voltage(&self, model: &Fit) -> Option<Fit> {
        if self.bench.has_phases() {
            return None;
        }
        self.changed(model, |t| {
            let is_seen = t.kind == EffectKind::SupplySag && matches!(t.shape[0], 0.0 | 1.0);
            if is_seen {
                t.shape[0] = 1.0 - t.shape[0];
            }
            is_seen
        })
    }

    /// A model whose spring differs by less than the sensors' noise wherever the motor is, with the constant torque in which that is at ease.
    pub(super) fn at_ease(&self, model: Fit) -> Fit {
        let Some(at) = model.terms.iter().position(|t| t.kind == EffectKind::SpringLoad) else {
            return model;
        };
        let spring = &model.terms[at];
        let columns = Regressor::new(&self.fit, spring.kind, &spring.shape, &self.constants).linear;
        let [by_angle, constant] = columns.as_slice() else {
            return model;
        };
        let mean = dot(by_angle, constant) / dot(constant, constant).max(1e-300);
        let differs: Vec<f64> = by_angle.iter().zip(constant).map(|(a, c)| a - mean * c).collect();
        if spring.amplitudes[0].powi(2) * dot(&differs, &differs) > self.fit.sensor_energy(Equation::Torque.index()) {
            return model;
        }
        let mut terms = model.terms.clone();
        terms[at] = Term {
            kind: EffectKind::BiasTorque,
            shape: Vec::new(),
            amplitudes: Vec::new(),
        };
        self.polish(&self.solve(&terms, model.sigma), 1)
    }

    /// A model with terms changed, and solved again; `None` where none is one that changes.
    fn changed(&self, model: &Fit, change: impl Fn(&mut Term) -> bool) -> Option<Fit> {
        let mut terms = model.terms.clone();
        let any = terms.iter_mut().map(change).filter(|changed| *changed).count() > 0;
        any.then(|| self.solve(&terms, model.sigma))
    }

    /// A model with terms changed, and solved again, where that tells the data better.
    fn if_better(&self, model: Fit, change: impl Fn(&mut Term) -> bool) -> Fit {
        self.unless_worse(model, 0.0, change)
    }

    /// The same unless it tells them worse.
    ///
    /// * `by` log-likelihood that it may lose
    /// * `change` of a term; whether it is one that changes
    fn unless_worse(&self, model: Fit, by: f64, change: impl Fn(&mut Term) -> bool) -> Fit {
        let Some(changed) = self.changed(&model, change) else {
            return model;
        };
        let changed = self.polish(&changed, 2);
        if penalised(self, &changed) > penalised(self, &model) - by {
            changed
        } else {
            model
        }
    }
}
