"""Assignment of models to splits: a hash of ids reserves a fifth of every role for test rooms. Models
that share a shape or a texture stay in one split."""

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final

from roomlight.dataset.recording import Split

_SHARE: Final = 0.2


def assign_splits(roles: Mapping[str, str], shared: Mapping[str, Sequence[str]]) -> dict[str, Split]:
    """Return the split of every model.

    A role with three models or more has a model in each split, unless all its models belong together. The order of the
    arguments does not matter.

    Args:
        roles: Role of each model id.
        shared: Digests of the geometry and the textures of each id: ids that share a digest stay together.
    """
    groups = _groups(roles, shared)
    total = Counter(roles.values())
    wanted = {role: max(1, round(_SHARE * count)) if count >= 3 else 0 for role, count in total.items()}
    reserved: Counter[str] = Counter()
    test: set[str] = set()

    def reserve(group: Sequence[str]) -> None:
        test.update(group)
        reserved.update(roles[identity] for identity in group)

    def overshoot(group: Sequence[str]) -> int:
        counts = Counter(roles[identity] for identity in group)
        return sum(max(reserved[role] + count - wanted[role], 0) for role, count in counts.items())

    for group in groups:
        counts = Counter(roles[identity] for identity in group)
        useful = sum(min(count, max(wanted[role] - reserved[role], 0)) for role, count in counts.items())
        spares = all(reserved[role] + count <= max(wanted[role], total[role] // 3) for role, count in counts.items())
        if 2 * useful > len(group) and spares:
            reserve(group)
    for role in sorted(total):
        if wanted[role] and not reserved[role]:
            fitting = [
                group
                for group in groups
                if any(roles[identity] == role for identity in group)
                and all(
                    reserved[shared_role] + count < total[shared_role]
                    for shared_role, count in Counter(roles[identity] for identity in group).items()
                )
            ]
            if fitting:
                reserve(min(fitting, key=overshoot))
    return {identity: "test" if identity in test else "train" for identity in roles}


def _groups(roles: Mapping[str, str], shared: Mapping[str, Sequence[str]]) -> list[list[str]]:
    """Return groups of ids that must stay together, in the order of a hash."""
    leader = {identity: identity for identity in roles}

    def find(identity: str) -> str:
        while leader[identity] != identity:
            identity = leader[identity]
        return identity

    holder: dict[str, str] = {}
    for identity in sorted(roles):
        for digest in shared.get(identity, ()):
            other = holder.setdefault(digest, identity)
            first, second = sorted((find(identity), find(other)))
            leader[second] = first
    groups: dict[str, list[str]] = {}
    for identity in sorted(roles):
        groups.setdefault(find(identity), []).append(identity)
    return sorted(groups.values(), key=lambda group: hashlib.sha256(group[0].encode()).digest())
