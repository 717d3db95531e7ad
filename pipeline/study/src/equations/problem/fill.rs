//! What a problem's rows are made of.

use super::{Problem, over};
use crate::equations::nuisances::{Nuisance, SENSOR_OFFSET_OF_RANGE};
use crate::equations::pieces::{Column, Piece, wide};
use crate::equations::whitener::{Rows, Set};
use crate::measured::bench::{Bench, BenchChannel};
use crate::measured::filter::FilterBank;
use crate::measured::recording::{Run, files, range};
use crate::measured::samples::moved;
use sim_worker::effect::Equation;

impl Problem {
    /// Left-hand sides and nuisance columns.
    pub(super) fn fill(&mut self, bench: &Bench, runs: &[&Run], nuisances: &[Nuisance]) {
        use BenchChannel as C;
        let rig = &bench.rig;
        let (kt, b0, tc) = (rig.drive_constant.value, rig.viscous.value, rig.coulomb.value);
        let (r0, l0, ke) = (rig.resistance.value, rig.inductance.value, rig.back_emf.value);
        let dt = 1.0 / self.clock.rate_hz;
        let mut base = vec![vec![0.0; self.rows]; nuisances.len()];
        let mut y = vec![0.0; self.rows];
        let mut offsets = Vec::new();
        let mut supplies = Vec::new();
        let mut drive = vec![0.0; self.rows];
        let place = |name: &str| nuisances.iter().position(|n| n.name == name);
        for (r, (s, run)) in self.signals.iter().zip(runs).enumerate() {
            let of = |e: Equation| self.blocks.iter().find(|b| b.run == r && b.equation == e);
            let targets = [of(Equation::Torque), of(Equation::Kinematic)];
            let put = |out: &mut [f64], rows: &Rows, factor: f64| {
                for (block, values) in targets.iter().zip(rows) {
                    let Some(b) = block else { continue };
                    out[b.rows.clone()]
                        .iter_mut()
                        .zip(values)
                        .for_each(|(o, v)| *o = factor * v);
                }
            };
            let one = |signals: Set| self.mechanics.rows(&[signals], s).remove(0);
            let torque = |t: &[f64]| one([Some(t), None, None]);
            let speed_of = |v: &[f64]| one([None, None, Some(v)]);
            let at = |c: C| run.channel(c).map(|x| moved(x, self.clock.lateness(bench, c).0));
            let (position, velocity) = (at(C::Position), at(C::Velocity));
            let each = |f: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..s.n).map(f).collect() };
            let net = each(&|k| kt * s.drive[k] - s.load[k] - b0 * s.omega[k] - tc * s.sign[k] - rig.offset);
            let seen = one([None, position.as_deref(), velocity.as_deref()]);
            let expected = torque(&net);
            // the torque that is expected to be left for J dw/dt, and what the motion makes of it
            let left: Rows = if self.clock.steady {
                expected.clone()
            } else {
                std::array::from_fn(|i| expected[i].iter().zip(&seen[i]).map(|(e, s)| e + s).collect())
            };
            put(&mut y, &left, 1.0);
            let push = torque(&each(&|k| kt * s.drive[k]));
            put(&mut drive, &push, 1.0);
            let mut column = |name: &str, rows: &dyn Fn() -> Rows, factor: f64| {
                if let Some(c) = place(name) {
                    put(&mut base[c], &rows(), factor);
                }
            };
            if !self.clock.steady {
                // the torque that is left to it stands for J dw/dt, whose noise would shrink it
                column("inertia", &|| expected.clone(), 1.0);
            }
            column("viscous", &|| torque(&each(&|k| wide(b0) * s.omega[k])), 1.0);
            column("coulomb", &|| torque(&each(&|k| wide(tc) * s.sign[k])), 1.0);
            column("torque_constant", &|| push.clone(), -1.0);
            column("drive_gain", &|| push.clone(), -1.0);
            column("offset", &|| torque(&vec![rig.offset; s.n]), 1.0);
            column("drive_offset", &|| torque(&vec![kt; s.n]), 1.0);
            column("drive_clock", &|| torque(&each(&|k| kt * dt * s.drive_rate[k])), 1.0);
            if velocity.is_some() && position.is_some() {
                column("velocity_gain", &|| speed_of(&s.omega), 1.0);
                column("velocity_offset", &|| speed_of(&vec![1.0; s.n]), 1.0);
                column("velocity_clock", &|| speed_of(&each(&|k| dt * s.accel[k])), 1.0);
            }
        }
        for block in &self.blocks {
            let (s, run) = (&self.signals[block.run], runs[block.run]);
            let bank = |c: C| self.clock.bank(bench, c);
            let raw = |c: C, order: usize| -> Vec<f64> {
                match run.channel(c) {
                    Some(x) => {
                        let b = bank(c);
                        block.samples.iter().map(|&k| within(&b, order, x, k)).collect()
                    }
                    None => vec![0.0; block.samples.len()],
                }
            };
            let common = |order: usize, x: &[f64]| -> Vec<f64> {
                block.samples.iter().map(|&k| self.bank.order[order].at(x, k)).collect()
            };
            let mut column = |name: &str, values: &dyn Fn(usize) -> f64| {
                if let Some(c) = place(name) {
                    for (i, row) in block.rows.clone().enumerate() {
                        base[c][row] = values(i);
                    }
                }
            };
            let y = &mut y[block.rows.clone()];
            match block.equation {
                Equation::Torque | Equation::Kinematic => {}
                Equation::Electrical if s.phases.is_some() => {
                    let p = s.phases.as_ref().expect("checked");
                    let each = p.rows();
                    let (r, l, ke) = (0.5 * r0, 0.5 * l0, 0.5 * ke);
                    let volts = p.voltage.as_ref().expect("the equation is open");
                    let over = |x: &[f64], order: usize, k: usize| over(x, order, k, self.window, s.rate_hz);
                    let flux: [Vec<f64>; 3] = std::array::from_fn(|q| p.back_emf(s, q));
                    let mut columns = [vec![0.0; y.len()], vec![0.0; y.len()], vec![0.0; y.len()]];
                    for (w, &k) in block.samples.iter().step_by(each).enumerate() {
                        for q in 0..3 {
                            let of = [
                                r * over(&p.current[q], 0, k),
                                l * over(&p.current[q], 1, k),
                                ke * over(&flux[q], 0, k),
                            ];
                            let left = over(&volts[q], 0, k) - of.iter().sum::<f64>();
                            for (row, part) in p.taken(q) {
                                let i = w * each + row;
                                y[i] += part * left;
                                columns.iter_mut().zip(of).for_each(|(c, x)| c[i] += part * x);
                            }
                        }
                        if let (Some(row), Some(v_dc)) = (p.supply_row(), &p.supply) {
                            y[w * each + row] = self.supply_scale * (over(v_dc, 0, k) - rig.supply_voltage);
                        }
                    }
                    column("resistance", &|i| columns[0][i]);
                    column("inductance", &|i| columns[1][i]);
                    column("between_samples", &|i| columns[1][i]);
                    column("torque_constant", &|i| columns[2][i]);
                    column("voltage_gain", &|i| columns[0][i] + columns[1][i] + columns[2][i]);
                    column("drive_gain", &|i| columns[0][i]);
                    if let Some(row) = p.supply_row() {
                        supplies.push((block.rows.start + row..block.rows.end, each));
                    }
                }
                Equation::Electrical => {
                    let mean = |x: &[f64], order: usize| -> Vec<f64> {
                        block
                            .samples
                            .iter()
                            .map(|&k| over(x, order, k, self.window, s.rate_hz))
                            .collect()
                    };
                    let (volts, turned) = s.voltage.as_ref().zip(s.within.as_ref()).expect("the equation is open");
                    let (v, i_, di, w) = (mean(volts, 0), mean(&s.drive, 0), mean(&s.drive, 1), mean(turned, 0));
                    let (dv, dw) = (mean(volts, 1), mean(&s.omega, 1));
                    for i in 0..y.len() {
                        y[i] = v[i] - (r0 * i_[i] + l0 * di[i] + ke * w[i]);
                    }
                    let of_winding = s.of_winding(y.len());
                    let mut column = |name: &str, values: &dyn Fn(usize) -> f64| {
                        column(name, &|i| if i < of_winding { values(i) } else { 0.0 });
                    };
                    column("resistance", &|i| r0 * i_[i]);
                    column("inductance", &|i| wide(l0) * di[i]);
                    column("torque_constant", &|i| ke * w[i]);
                    column("voltage_offset", &|_| 1.0);
                    column("voltage_gain", &|i| r0 * i_[i] + l0 * di[i] + ke * w[i]);
                    column("voltage_clock", &|i| dv[i] * dt);
                    column("between_samples", &|i| wide(l0) * di[i]);
                    column("motion_clock", &|i| ke * dw[i] * dt);
                    column("drive_offset", &|_| -r0);
                    column("drive_gain", &|i| r0 * i_[i]);
                    if let Some(v_dc) = s.supply.as_ref().filter(|_| of_winding < y.len()) {
                        let usual = v_dc.iter().sum::<f64>() / s.n as f64;
                        let seen = mean(v_dc, 0);
                        for i in of_winding..y.len() {
                            y[i] = self.supply_scale * (seen[i] - usual);
                        }
                        supplies.push((block.rows.start + of_winding..block.rows.end, 1));
                    }
                }
                Equation::Transmission => {
                    let (u, t) = (raw(C::UserPosition, 0), raw(C::Position, 0));
                    let followed = s.played(&s.theta, rig.play);
                    let lag: Vec<f64> = followed.iter().zip(&s.theta).map(|(f, t)| f - t).collect();
                    let lag = common(0, &lag);
                    for i in 0..y.len() {
                        y[i] = u[i] - t[i] - lag[i];
                    }
                    column("play", &|i| lag[i]);
                    let speed = common(0, &s.omega);
                    column("user_clock", &|i| speed[i] * dt);
                    offsets.push(block.rows.clone());
                }
                Equation::Controller => {
                    let law = &s.law.as_ref().expect("the equation is open").0;
                    let (u, l) = (raw(rig.drive, 1), common(1, law));
                    // of the law, not of the drive: a regressand that explains itself shrinks
                    let ll = common(2, law);
                    for i in 0..y.len() {
                        y[i] = u[i] - l[i];
                    }
                    column("law_gain", &|i| l[i]);
                    column("law_clock", &|i| ll[i] * dt);
                }
            }
        }
        self.y = y;
        self.drive = drive;
        self.base = base;
        self.dry_friction = place("coulomb");
        self.inertia = place("inertia").filter(|_| !self.clock.steady);
        for rows in offsets {
            let mut c = vec![0.0; self.rows];
            c[rows].fill(1.0);
            self.add_local(c, None);
        }
        for (rows, each) in supplies {
            // the supply's own voltage
            let mut c = vec![0.0; self.rows];
            rows.step_by(each).for_each(|row| c[row] = self.supply_scale);
            self.add_local(c, None);
        }
        self.add_phase_offsets(bench, runs);
        self.add_days(bench, runs, [place("coulomb"), place("viscous")]);
    }

    pub(super) fn add_local(&mut self, column: Vec<f64>, trust: Option<f64>) {
        self.local.push(column);
        self.local_trust.push(trust);
    }

    /// Frictions of each file's own.
    ///
    /// * `frictions` places of their columns
    fn add_days(&mut self, bench: &Bench, runs: &[&Run], frictions: [Option<usize>; 2]) {
        let rig = &bench.rig;
        if rig.friction_of_day <= 0.0 {
            return;
        }
        let sizes = [rig.coulomb.value, rig.viscous.value];
        let seen = frictions.into_iter().zip(sizes).filter(|(_, size)| *size > 0.0);
        for column in seen.filter_map(|(column, _)| column) {
            for file in files(runs.iter().copied()) {
                let mut own = vec![0.0; self.rows];
                for b in self.blocks.iter().filter(|b| self.files[b.run] == file) {
                    own[b.rows.clone()].copy_from_slice(&self.base[column][b.rows.clone()]);
                }
                self.add_local(own, Some(rig.friction_of_day));
            }
        }
    }

    /// Offsets of the phases' sensors, of each file its own.
    fn add_phase_offsets(&mut self, bench: &Bench, runs: &[&Run]) {
        let Some(trust) = bench.channel(BenchChannel::CurrentA).map(|c| {
            let of_range = SENSOR_OFFSET_OF_RANGE * range(runs, BenchChannel::CurrentA);
            c.offset.unwrap_or(of_range)
        }) else {
            return;
        };
        let (r, ke) = (0.5 * bench.rig.resistance.value, 0.5 * bench.rig.drive_constant.value);
        for file in files(runs.iter().copied()) {
            for q in 0..3 {
                let pieces: Vec<Column> = self
                    .signals
                    .iter()
                    .zip(runs)
                    .map(|(s, run)| {
                        let Some(p) = s.phases.as_ref().filter(|_| run.hash == file) else {
                            return Column::new();
                        };
                        let piece = |equation, signal, phase| Piece {
                            equation,
                            order: 0,
                            signal,
                            phase,
                        };
                        vec![
                            piece(Equation::Torque, p.mean_over_support(s, q, |trap| ke * trap), None),
                            piece(Equation::Electrical, vec![-r; s.n], Some(q)),
                        ]
                    })
                    .collect();
                let column = self.column(&pieces);
                self.add_local(column, Some(trust));
            }
        }
    }
}

/// A channel's own kernels may reach a little further than the common ones: the ends are held.
fn within(bank: &FilterBank, order: usize, x: &[f64], k: usize) -> f64 {
    let half = bank.half();
    bank.order[order].at(x, k.clamp(half, x.len() - 1 - half))
}
