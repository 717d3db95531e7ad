use super::*;

const FREE: Span = (f64::NEG_INFINITY, f64::INFINITY);

struct Rng(u64);

impl Rng {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, a: f64, b: f64) -> f64 {
        a + (b - a) * self.unit()
    }

    fn sign(&mut self) -> f64 {
        if self.unit() < 0.5 { -1.0 } else { 1.0 }
    }

    fn axis(&mut self, n: usize, start: f64) -> Vec<f64> {
        let mut x = vec![start];
        (1..n).for_each(|k| x.push(x[k - 1] + self.between(0.3, 1.7) / n as f64));
        x
    }
}

fn span(i: Interval) -> Span {
    (i.lo, i.hi)
}

fn hull(p: &Part) -> Limits {
    let (f, z) = (span(p.fsj), span(p.zeta));
    Limits { f, z }
}

fn lattice_of(f: Vec<f64>, z: Vec<f64>, m: impl Fn(f64, f64) -> Row, directions: [(f64, f64); MOST]) -> Lattice {
    let nodes = z
        .iter()
        .flat_map(|&z| f.iter().map(move |&f| (f, z)))
        .map(|(f, z)| m(f, z))
        .collect();
    Lattice::new(f, z, nodes, directions).expect("a sound lattice")
}

/// Curved, noisy surfaces with slopes of either sign; `spread` near 0 makes them nearly parallel.
fn random_lattice(rng: &mut Rng, spread: f64) -> Lattice {
    let (f, z) = (rng.axis(9, 0.2), rng.axis(11, -0.3));
    let common = rng.sign();
    let mut directions = [(1.0, 1.0); MOST];
    let mut shape = [[0.0; 3]; MOST];
    for i in 0..6 {
        let s = rng.sign();
        directions[i] = (s, if spread < 1.0 { s * common } else { rng.sign() });
        shape[i] = [rng.between(-1.0, 1.0), rng.between(-1.0, 1.0), rng.unit()].map(|x| (spread * x).exp());
    }
    let m = |f: f64, z: f64| {
        std::array::from_fn(|i| {
            let ([a, b, c], (s, t)) = (shape[i], directions[i]);
            let wave = spread * 0.05 * (40.0 * f + 30.0 * z + i as f64).sin();
            if i < 6 {
                s * a * f + t * b * (z + 0.3 * spread * (c - 1.0) * z * z) + wave
            } else {
                0.0
            }
        })
    };
    lattice_of(f, z, m, directions)
}

/// A joint that holds at (f, z), its region about `size` across.
fn random_joint(rng: &mut Rng, lattice: &Lattice, (f, z): (f64, f64), size: f64) -> Joint {
    let mut w = [[0.0; MOST]; MOST];
    for (k, row) in w.iter_mut().enumerate().take(6) {
        for (i, x) in row.iter_mut().enumerate().take(6) {
            *x = (rng.between(-0.5, 0.5) + if i == k { 1.5 } else { 0.0 }) / size;
        }
    }
    let m = lattice.at(f, z);
    let offset = w.map(|row| {
        if row[0] == 0.0 {
            0.0
        } else {
            dot(&row, &m) + rng.between(-0.6, 0.6)
        }
    });
    Joint {
        w,
        offset,
        threshold: 6.0,
    }
}

fn everything(lattice: &Lattice) -> Limits {
    let ends = |axis: &[f64]| (axis[0], axis[axis.len() - 1]);
    Limits {
        f: ends(&lattice.fsj),
        z: ends(&lattice.zeta),
    }
}

fn inside(span: Span, x: f64, slack: f64) -> bool {
    span.0 - slack <= x && x <= span.1 + slack
}

/// Checks the paving against point samples; `dense` asks for tolerances met. Returns it with the members sampled.
fn check(
    lattice: &Lattice,
    joint: &Joint,
    bands: &[Span; MOST],
    domain: Limits,
    dense: bool,
) -> (Option<Paving>, usize) {
    let paving = Paver::new().pave(lattice, joint, bands, &domain, &Goal::default());
    // Members by a relative margin of 1e-9: -1 surely not, 0 too close to say, 1 surely.
    let member = |f: f64, z: f64| {
        let m = lattice.at(f, z);
        let test = |slack: f64| {
            joint.misfit(&m) <= joint.threshold * (1.0 + slack)
                && (0..MOST).all(|i| inside(bands[i], m[i], slack * (1.0 + m[i].abs())))
        };
        i32::from(test(-1e-9)) + i32::from(test(1e-9)) - 1
    };
    let mut windows = vec![domain];
    if let Some(p) = &paving {
        let h = hull(&p.whole);
        assert!(domain.holds(&h), "hull {h:?} leaves the domain");
        let grow = |s: Span, d: Span| ((s.0 - 0.1 * (s.1 - s.0)).max(d.0), (s.1 + 0.1 * (s.1 - s.0)).min(d.1));
        windows.push(Limits {
            f: grow(h.f, domain.f),
            z: grow(h.z, domain.z),
        });
        for b in p.boxes.iter().filter(|b| b.inside) {
            for (u, v) in [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0), (0.5, 0.5), (0.2, 0.9)] {
                assert!(
                    member(lerp(span(b.fsj), u), lerp(span(b.zeta), v)) >= 0,
                    "{b:?} is not inside"
                );
            }
        }
    }
    let (n, mut found) = (90, 0);
    for w in windows {
        let (mut count, mut sampled) = (0, Limits::NONE);
        for k in 0..n * n {
            let at = |k: usize| (k as f64 + 0.5) / n as f64;
            let (f, z) = (lerp(w.f, at(k % n)), lerp(w.z, at(k / n)));
            let is = member(f, z);
            let holds = |b: &&PavedBox| b.fsj.contains(f) && b.zeta.contains(z);
            let held: Vec<&PavedBox> = paving.iter().flat_map(|p| p.boxes.iter()).filter(holds).collect();
            assert!(is < 1 || !held.is_empty(), "({f}, {z}) is in S but in no box");
            assert!(
                is >= 0 || held.iter().all(|b| !b.inside),
                "({f}, {z}) is not in S but in a box inside"
            );
            if is == 1 {
                count += 1;
                sampled.join(&Limits { f: (f, f), z: (z, z) });
            }
        }
        found += count;
        if let Some(p) = paving.as_ref().filter(|_| count > 1000) {
            let (o, i, cell) = (hull(&p.whole), p.whole.inner_hull.unwrap(), 4.0 / n as f64);
            let width = ((w.f.1 - w.f.0) * cell, (w.z.1 - w.z.0) * cell);
            assert!(o.holds(&sampled));
            assert!(
                sampled.excess(&i, (1.0, 1.0)) <= width.0.max(width.1),
                "inner hull {i:?} beyond {sampled:?}"
            );
            let area = count as f64 / (n * n) as f64 * (w.f.1 - w.f.0) * (w.z.1 - w.z.0);
            let noise = 0.04 * area;
            assert!(
                p.whole.inner <= area + noise && area - noise <= p.whole.outer,
                "area {area} {p:?}"
            );
        }
    }
    if let Some(p) = &paving {
        let sum = |all: bool| -> f64 {
            let boxes = p.boxes.iter().filter(|b| all || b.inside);
            boxes.map(|b| b.fsj.width() * b.zeta.width()).sum()
        };
        let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * p.whole.outer;
        assert!(close(sum(true), p.whole.outer) && close(sum(false), p.whole.inner));
        assert!(close(p.parts.iter().map(|p| p.outer).sum(), p.whole.outer));
        assert!(
            !dense || (p.area_gap <= 0.05 && p.hull_gap <= 0.005),
            "{} {}",
            p.area_gap,
            p.hull_gap
        );
        assert!(p.boxes.len() <= 20_000);
    }
    (paving, found)
}

#[test]
fn prop_random_sets_lie_between_inner_and_outer() {
    let (mut rng, mut total) = (Rng(1), 0);
    for case in 0..60 {
        let lattice = random_lattice(&mut rng, 1.0);
        let mut domain = everything(&lattice);
        let at = (
            lerp(domain.f, rng.between(0.1, 0.9)),
            lerp(domain.z, rng.between(0.1, 0.9)),
        );
        let size = 10f64.powf(rng.between(-3.0, 0.0));
        let joint = random_joint(&mut rng, &lattice, at, size);
        let mut bands = [FREE; MOST];
        if case % 3 == 1 {
            // The domain's edge cuts the region, off the lattice lines.
            domain = Limits {
                f: (domain.f.0, at.0 + 0.1 * size),
                z: (at.1 - 0.2 * size, domain.z.1),
            };
        } else if case % 3 == 2 {
            let m = lattice.at(at.0, at.1);
            bands = std::array::from_fn(|i| {
                if i % 2 == 0 {
                    (m[i] - 0.3 * size, m[i] + 0.2 * size)
                } else {
                    FREE
                }
            });
        }
        let (paving, found) = check(&lattice, &joint, &bands, domain, true);
        assert!(paving.is_some() || found == 0);
        total += usize::from(found > 1000);
    }
    assert!(total > 40, "only {total} thick sets");
}

#[test]
fn prop_slivers() {
    let mut rng = Rng(2);
    for case in 0..20 {
        let lattice = random_lattice(&mut rng, if case < 15 { 0.2 } else { 0.03 });
        let domain = everything(&lattice);
        let at = (lerp(domain.f, 0.5), lerp(domain.z, 0.5));
        let joint = random_joint(&mut rng, &lattice, at, 0.02);
        check(&lattice, &joint, &[FREE; MOST], domain, false);
    }
}

/// M0 = FSJ and M1 = -zeta, so that Q is an exact ellipse.
fn plain() -> Lattice {
    let mut directions = [(1.0, 1.0); MOST];
    directions[1] = (1.0, -1.0);
    let mut rng = Rng(3);
    lattice_of(
        rng.axis(20, 0.0),
        rng.axis(20, 0.0),
        |f, z| [f, -z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        directions,
    )
}

fn ellipse(f: f64, z: f64, a: f64, b: f64) -> Joint {
    let (mut w, mut offset) = ([[0.0; MOST]; MOST], [0.0; MOST]);
    (w[0][0], w[1][1]) = (1.0 / a, 1.0 / b);
    (offset[0], offset[1]) = (f / a, -z / b);
    Joint {
        w,
        offset,
        threshold: 1.0,
    }
}

#[test]
fn prop_ellipse_has_its_area_hull_and_centroid() {
    let (lattice, mut rng) = (plain(), Rng(4));
    // One paver for all: nothing may be left over from the set before.
    let mut paver = Paver::new();
    for _ in 0..200 {
        let (a, b) = (10f64.powf(rng.between(-6.0, -0.7)), 10f64.powf(rng.between(-6.0, -0.7)));
        let (f, z) = (rng.between(0.3, 0.6), rng.between(0.3, 0.6));
        let p = paver
            .pave(
                &lattice,
                &ellipse(f, z, a, b),
                &[FREE; MOST],
                &everything(&lattice),
                &Goal::default(),
            )
            .expect("a set");
        let area = std::f64::consts::PI * a * b;
        assert!(p.whole.inner <= area && area <= p.whole.outer, "{area} {:?}", p.whole);
        let exact = Limits {
            f: (f - a, f + a),
            z: (z - b, z + b),
        };
        assert!(hull(&p.whole).excess(&exact, (a, b)) <= 1e-9 && exact.excess(&hull(&p.whole), (a, b)) <= 0.01);
        assert!(
            p.area_gap <= 0.05 && p.hull_gap <= 0.005 && p.parts.len() == 1,
            "{a} {b} {} {} {:?}",
            p.area_gap,
            p.hull_gap,
            p.parts
        );
        assert!((p.whole.centroid.0 - f).abs() < 0.02 * a && (p.whole.centroid.1 - z).abs() < 0.02 * b);
    }
}

#[test]
fn prop_empty_sets_are_proved_empty() {
    let (lattice, mut rng) = (random_lattice(&mut Rng(5), 1.0), Rng(6));
    let domain = everything(&lattice);
    for _ in 0..30 {
        let mut joint = random_joint(&mut rng, &lattice, (0.6, 0.2), 0.01);
        joint.offset[2] += 40.0;
        let (paving, found) = check(&lattice, &joint, &[FREE; MOST], domain, true);
        assert!(paving.is_none() && found == 0);
        joint = random_joint(&mut rng, &lattice, (0.6, 0.2), 0.01);
        let mut bands = [FREE; MOST];
        bands[3] = (1e3, 1e4);
        assert!(check(&lattice, &joint, &bands, domain, true).0.is_none());
        joint.threshold = -1.0;
        assert!(check(&lattice, &joint, &[FREE; MOST], domain, true).0.is_none());
    }
}

#[test]
fn prop_two_parts_are_told_apart() {
    // f + z and f^2 + z^2 known: two solutions, mirrored.
    let mut rng = Rng(7);
    for _ in 0..20 {
        let axes = (rng.axis(30, 0.0), rng.axis(25, 0.0));
        let lattice = lattice_of(
            axes.0,
            axes.1,
            |f, z| [f + z, f * f + z * z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [(1.0, 1.0); MOST],
        );
        let (f, z) = (rng.between(0.1, 0.25), rng.between(0.6, 0.7));
        let mut joint = ellipse(0.0, 0.0, 0.01, 0.01);
        let m = lattice.at(f, z);
        (joint.offset[0], joint.offset[1]) = (m[0] / 0.01, m[1] / 0.01);
        let p = check(&lattice, &joint, &[FREE; MOST], everything(&lattice), true)
            .0
            .expect("a set");
        let big: Vec<&Part> = p.parts.iter().filter(|p| p.inner > 0.0).collect();
        assert!(big.len() == 2 && p.parts.len() == 2, "{:?}", p.parts);
        assert!(p.parts[0].outer >= p.parts[1].outer);
        for (f, z) in [(f, z), (z, f)] {
            let near = |p: &&&Part| (p.centroid.0 - f).abs() < 0.02 && (p.centroid.1 - z).abs() < 0.02;
            assert!(big.iter().filter(near).count() == 1, "({f}, {z}) {big:?}");
        }
    }
}

#[test]
fn prop_sets_thinner_than_a_box_are_enclosed() {
    let lattice = plain();
    let point = Joint {
        threshold: 0.0,
        ..ellipse(0.41, 0.37, 0.01, 0.01)
    };
    let p = Paver::new()
        .pave(&lattice, &point, &[FREE; MOST], &everything(&lattice), &Goal::default())
        .expect("a point");
    let h = hull(&p.whole);
    assert!(inside(h.f, 0.41, 0.0) && inside(h.z, 0.37, 0.0) && h.f.1 - h.f.0 < 1e-4 && h.z.1 - h.z.0 < 1e-4);
    assert!(
        p.whole.inner == 0.0 && p.whole.inner_hull.is_none() && p.boxes.len() < 5000,
        "{} {:?}",
        p.boxes.len(),
        p.whole
    );
    // A slanted line, 1e-9 thick.
    let lattice = lattice_of(
        vec![0.0, 0.4, 1.0],
        vec![0.0, 0.7, 1.0],
        |f, z| [f + z; MOST],
        [(1.0, 1.0); MOST],
    );
    let mut joint = ellipse(0.0, 0.0, 1e-9, 1.0);
    joint.w[1] = [0.0; MOST];
    joint.offset[0] = 1e9;
    let p = check(&lattice, &joint, &[FREE; MOST], everything(&lattice), false)
        .0
        .expect("a line");
    assert!(hull(&p.whole).f == (0.0, 1.0) && hull(&p.whole).z == (0.0, 1.0) && p.parts.len() == 1);
    assert!(p.whole.outer < 1e-3);
}

#[test]
fn prop_bands_alone() {
    let mut rng = Rng(8);
    let free = Joint {
        w: [[0.0; MOST]; MOST],
        offset: [0.0; MOST],
        threshold: f64::INFINITY,
    };
    let lattice = plain();
    let mut bands = [FREE; MOST];
    (bands[0], bands[1]) = ((0.213, 0.507), (-0.611, f64::INFINITY));
    let p = check(&lattice, &free, &bands, everything(&lattice), true)
        .0
        .expect("a rectangle");
    let z = (lattice.zeta[0], 0.611);
    assert!(
        hull(&p.whole)
            .excess(&Limits { f: (0.213, 0.507), z }, (1.0, 1.0))
            .abs()
            < 1e-9
    );
    let area = 0.294 * (0.611 - z.0);
    assert!((p.whole.inner - area).abs() < 1e-3, "{} {area}", p.whole.inner);
    for _ in 0..20 {
        let lattice = random_lattice(&mut rng, 1.0);
        let domain = everything(&lattice);
        let m = lattice.at(lerp(domain.f, rng.unit()), lerp(domain.z, rng.unit()));
        let bands = std::array::from_fn(|i| (m[i] - rng.between(0.1, 0.3), m[i] + rng.between(0.1, 0.3)));
        let (paving, found) = check(&lattice, &free, &bands, domain, true);
        assert!(paving.is_some() && found > 0);
    }
    let all = Paver::new()
        .pave(&lattice, &free, &[FREE; MOST], &everything(&lattice), &Goal::default())
        .expect("all");
    assert!(hull(&all.whole) == everything(&lattice) && all.area_gap == 0.0);
}

#[test]
fn prop_lattice_is_made_monotone_and_checked() {
    let lattice = random_lattice(&mut Rng(9), 1.0);
    let n = lattice.fsj.len();
    for (k, node) in lattice
        .zeta
        .iter()
        .flat_map(|&z| lattice.fsj.iter().map(move |&f| (f, z)))
        .enumerate()
    {
        let here = lattice.at(node.0, node.1);
        for (i, &(df, dz)) in lattice.directions().iter().enumerate() {
            if k % n > 0 {
                assert!((here[i] - lattice.at(lattice.fsj[k % n - 1], node.1)[i]) * df >= 0.0);
            }
            if k >= n {
                assert!((here[i] - lattice.at(node.0, lattice.zeta[k / n - 1])[i]) * dz >= 0.0);
            }
        }
    }
    let bad =
        |f: Vec<f64>, n: usize| Lattice::new(f, vec![0.0, 1.0], vec![[0.0; MOST]; n], [(1.0, 1.0); MOST]).is_err();
    assert!(bad(vec![0.0, 0.0], 4) && bad(vec![0.0], 2) && bad(vec![0.0, 1.0], 3) && bad(vec![0.0, f64::NAN], 4));
    assert!(!bad(vec![0.0, 1.0], 4));
}
