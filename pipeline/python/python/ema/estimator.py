"""Failure maps as an estimator in the manner of scikit-learn, which is not needed for it."""

from __future__ import annotations

import inspect
from typing import Any, Sequence

import numpy as np

from . import _ema
from ._common import refused

try:
    from sklearn.base import BaseEstimator, RegressorMixin
    from sklearn.exceptions import NotFittedError
    from sklearn.utils.validation import validate_data

    _SKLEARN = True
except ImportError:
    _SKLEARN = False

    class NotFittedError(ValueError, AttributeError):  # type: ignore[no-redef]
        """The estimator was not fitted."""

    class RegressorMixin:  # type: ignore[no-redef]
        pass

    class BaseEstimator:  # type: ignore[no-redef]
        """`get_params` and `set_params`, as scikit-learn has them."""

        def get_params(self, deep: bool = True) -> dict[str, Any]:
            return {name: getattr(self, name) for name in inspect.signature(type(self)).parameters}

        def set_params(self, **params: Any) -> Any:
            known = self.get_params()
            for name, value in params.items():
                if name not in known:
                    raise ValueError(f"Invalid parameter {name!r} for estimator {self!r}. Valid parameters are: {list(known)!r}.")
                setattr(self, name, value)
            return self

        def __repr__(self) -> str:
            return f"{type(self).__name__}()"


#: Columns that faults are located by, in the order of an array without names: those of `ema.sweep`.
FEATURES = ("mean_speed_rad_per_s", "ripple_rad_per_s", "p2_a", "p3_rad", "rise_s", "current_rms_a")


class FaultEstimator(RegressorMixin, BaseEstimator):
    """Both faults from the features of a test, by failure maps that are made of your rows.

    The rows that it is fitted with are a regular grid of fault pairs, every pair once, in any order, the healthy pair (1, 0)
    among them: maps are surfaces over a grid. Rows that are predicted are any.

    Args:
        features: names of the columns of an array, those of `ema.sweep`; a table's own names if left out, or `FEATURES` for an
            array without names.
        coverage: share of rows whose true pair the intervals are to hold.
        sequence: the test that the features are of.
        rate_hz: telemetry rate of that test [Hz]: one sample of the ramp is part of P3's uncertainty.

    Attributes:
        fsj_, zeta_: lines of the grid.
        map_features_: features that have a map: those that are not monotone over the grid have none.
        n_features_in_, feature_names_in_: as in scikit-learn.
    """

    def __init__(
        self,
        features: Sequence[str] | None = None,
        coverage: float = 0.95,
        sequence: str = "preflight",
        rate_hz: float = 10_000.0,
    ) -> None:
        self.features = features
        self.coverage = coverage
        self.sequence = sequence
        self.rate_hz = rate_hz

    def fit(self, X: Any, y: Any, deviations: Any = None) -> FaultEstimator:
        """Makes the maps.

        Args:
            X: features, a row a fault pair: a table with the columns of `ema.sweep` (its columns ``..._sd`` are then the
                deviations), or an array.
            y: FSJ and zeta of each row, shape (n, 2), or two columns ``fsj`` and ``zeta`` of a table.
            deviations: standard deviations of the features by noise, in the form of an array `X`; 0 if left out.
        """
        if y is None:
            # in the words that scikit-learn's checks look for
            raise ValueError("This FaultEstimator estimator requires y to be passed, but the target y is None.")
        names, rows, sd = self._columns(X, fit=True)
        if deviations is not None:
            sd = np.asarray(deviations, dtype=float)
            if sd.shape != rows.shape:
                raise refused("deviations", f"shape {sd.shape}", f"{rows.shape}, that of X")
        faults = self._faults(y, len(rows))
        fsj, zeta = np.unique(faults[:, 0]), np.unique(faults[:, 1])
        place = np.searchsorted(zeta, faults[:, 1]) * len(fsj) + np.searchsorted(fsj, faults[:, 0])
        whole = len(faults) == len(fsj) * len(zeta) and len(np.unique(place)) == len(place)
        if not whole or len(fsj) < 2 or len(zeta) < 2:
            found = f"{len(faults)} rows of {len(fsj)} FSJ and {len(zeta)} zeta"
            raise refused("y", found, "every pair of a grid of two or more FSJ and zeta once: maps are surfaces over a grid")
        order = np.argsort(place)
        self._training = (fsj, zeta, names, rows[order], None if sd is None else sd[order])
        self._tests = None
        self._made = None
        self.map_features_ = self._maps().features
        self.fsj_, self.zeta_ = fsj, zeta
        return self

    def calibrate(self, X: Any, y: Any) -> FaultEstimator:
        """Fixes how far intervals reach by rows of known faults that it was not fitted with (split conformal prediction).

        Without it the coverage is one by design: that of Gaussian errors, with a margin (assumed). Two hundred rows or more in
        each quadrant of the faults are best.
        """
        maps = self._maps()
        _, rows, _ = self._columns(X, fit=False)
        faults = self._faults(y, len(rows))
        maps.calibrate(rows.tolist(), faults[:, 0].tolist(), faults[:, 1].tolist())
        self._tests = (rows, faults)
        return self

    def diagnose(self, X: Any, coverage: float | None = None) -> list[dict[str, Any]]:
        """What is found of each row: outcome, fsj and zeta (lo, hi, estimate; None where there are none), reason."""
        maps = self._maps()
        _, rows, _ = self._columns(X, fit=False)
        told = maps.diagnose(rows.tolist(), self.coverage if coverage is None else coverage)

        def interval(found: Any, k: int) -> dict[str, float | None]:
            values = (None,) * 3 if found is None else found[3 * k : 3 * k + 3]
            return dict(zip(("lo", "hi", "estimate"), values))

        return [
            {"outcome": outcome, "fsj": interval(found, 0), "zeta": interval(found, 1), "reason": reason}
            for outcome, found, reason in told
        ]

    def predict(self, X: Any) -> np.ndarray:
        """FSJ and zeta of each row, shape (n, 2); NaN where no pair of faults explains the row, or it lies beyond the maps."""
        found = self.diagnose(X)
        return np.array([[d[f]["estimate"] for f in ("fsj", "zeta")] for d in found], dtype=float).reshape(-1, 2)

    def predict_interval(self, X: Any, coverage: float | None = None) -> np.ndarray:
        """Intervals of each row: shape (n, 2, 2), FSJ and zeta, lower and upper end; NaN as in `predict`."""
        found = self.diagnose(X, coverage)
        ends = [[[d[f][end] for end in ("lo", "hi")] for f in ("fsj", "zeta")] for d in found]
        return np.array(ends, dtype=float).reshape(-1, 2, 2)

    def _maps(self) -> _ema.FittedMaps:
        if not hasattr(self, "_training"):
            raise NotFittedError(f"This {type(self).__name__} instance is not fitted yet. Call 'fit' first.")
        if self._made is None:
            fsj, zeta, names, rows, sd = self._training
            self._made = _ema.FittedMaps(
                fsj.tolist(),
                zeta.tolist(),
                list(names),
                rows.tolist(),
                None if sd is None else sd.tolist(),
                self.sequence,
                float(self.rate_hz),
            )
            if self._tests is not None:
                rows, faults = self._tests
                self._made.calibrate(rows.tolist(), faults[:, 0].tolist(), faults[:, 1].tolist())
        return self._made

    def _columns(self, X: Any, fit: bool) -> tuple[list[str], np.ndarray, np.ndarray | None]:
        """Names and values of the features, and their standard deviations where a table has them."""
        # some sparse matrices are dicts
        if isinstance(X, (_ema.Table, dict)) and not hasattr(X, "tocsr"):
            table, own = X, list(X.keys())
        else:
            table, own = X, [str(c) for c in getattr(X, "columns", [])]
        wanted = list(self.features) if self.features is not None else None
        if own and (wanted is None or set(wanted) <= set(own)):
            if fit:
                names = wanted or [c for c in own if c in FEATURES]
                if not names:
                    raise refused("X", ", ".join(own[:20]), f"a table with columns {', '.join(FEATURES)}")
            else:
                names = self._training[2]
            missing = [c for c in names if c not in own]
            if missing:
                raise refused("X", f"no column {missing[0]}", ", ".join(names))
            values = np.column_stack([np.asarray(table[c], dtype=float) for c in names])
            spread = [_deviation(c) for c in names]
            sd = None
            if fit and all(c in own for c in spread):
                sd = np.nan_to_num(np.column_stack([np.asarray(table[c], dtype=float) for c in spread]))
            if fit:
                self.n_features_in_ = len(names)
                self.feature_names_in_ = np.array(names, dtype=object)
            return list(names), values, sd
        if _SKLEARN:
            values = validate_data(self, X, reset=fit, dtype=float, ensure_all_finite="allow-nan")
        else:
            values = np.asarray(X, dtype=float)
            if values.ndim != 2:
                raise refused("X", f"{values.ndim} dimensions", "two: a row a test")
            if fit:
                self.n_features_in_ = values.shape[1]
            elif values.shape[1] != self.n_features_in_:
                raise refused("X", f"{values.shape[1]} features", f"{self.n_features_in_}, as it was fitted with")
        names = wanted or list(FEATURES)
        if len(names) != values.shape[1]:
            found = f"n_samples = {len(values)}, n_features = {values.shape[1]}"
            raise refused("X", found, f"{len(names)} features: {', '.join(names)} (features=... names others)")
        return names, values, None

    @staticmethod
    def _faults(y: Any, rows: int) -> np.ndarray:
        if isinstance(y, (_ema.Table, dict)) or hasattr(y, "columns"):
            faults = np.column_stack([np.asarray(y[c], dtype=float) for c in ("fsj", "zeta")])
        else:
            faults = np.asarray(y, dtype=float)
        if faults.shape != (rows, 2) or not np.isfinite(faults).all():
            raise refused("y", f"shape {faults.shape}", f"({rows}, 2): finite FSJ and zeta of each row of X")
        return faults

    def __getstate__(self) -> dict[str, Any]:
        # maps are made again of their rows, to the same bits
        state = dict(super().__getstate__() if _SKLEARN else self.__dict__)
        if "_made" in state:
            state["_made"] = None
        return state

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "_training")

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        tags.target_tags.single_output = False
        tags.target_tags.required = True
        tags.input_tags.allow_nan = True
        # a score over rows that are no grid says nothing
        tags.regressor_tags.poor_score = True
        return tags


def _deviation(column: str) -> str:
    """Column of the standard deviation of a feature."""
    for unit in ("_rad_per_s", "_rad", "_a", "_s"):
        if column.endswith(unit):
            return column.removesuffix(unit) + "_sd" + unit
    return column + "_sd"
