"""Refusals of control: each says who has it, for how long, and what to do."""

from server.errors import ServerError


class AccessError(ServerError):
    """Base of the refusals. `references` are facts for programs: owner, fencing, seconds left."""

    code = "access"
    status = 403


class RoleError(AccessError):
    """The caller's role does not allow this."""

    code = "forbidden"
    hint = "use a key with a role that may; `longreach keys list` shows names and roles"


class NoLeaseError(AccessError):
    """The command carries no lease, or one that was never given."""

    code = "no_lease"
    hint = "POST /v1/lease, then send its lease_id and fencing in the headers Longreach-Lease and Longreach-Fencing"


class LeaseLostError(AccessError):
    """The lease was valid earlier; since then another client has taken control, or it was given up."""

    code = "lease_lost"
    status = 409
    hint = "another client has control: request it (POST /v1/lease/ask) or, as a person, take it (POST /v1/lease/take)"


class LeaseStaleError(AccessError):
    """The lease was not kept alive; its holder may revive it until another client acquires it."""

    code = "lease_stale"
    status = 409
    hint = "PUT /v1/lease/{lease_id} renews it, then send the command again; renew it every third of ttl_s"


class LeaseHeldError(AccessError):
    """Another client holds the lease."""

    code = "lease_held"
    status = 409
    hint = "wait, request it (POST /v1/lease/ask) or, as a person, take it (POST /v1/lease/take)"


class TakeRefusedError(AccessError):
    """A forced take is for persons; a fleet's program may ask and wait."""

    code = "take_refused"
    hint = "a fleet acquires a free lease, or requests it from the holder (POST /v1/lease/ask)"
