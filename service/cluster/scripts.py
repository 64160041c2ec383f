"""The scripts that Redis runs: each compares and sets in one step.

An epoch is a number that rises with every claim of a session. It begins with the microseconds of a clock, so that it
also rises after Redis has lost its data.
"""

# Saves a session, unless a later claim exists. KEYS: session, its past, sessions of the owner.
# ARGV: epoch, holder, milliseconds to keep it, instant when it expires, id, first seq that is kept,
# number n of fields, n names and values of fields, then seq and entry of each result.
SAVE = """
local seen = redis.call('HGET', KEYS[1], 'epoch')
if seen and tonumber(seen) > tonumber(ARGV[1]) then return 0 end
if redis.call('HEXISTS', KEYS[1], 'ended') == 1 then return 0 end
local n = tonumber(ARGV[7])
redis.call('HSET', KEYS[1], 'epoch', ARGV[1], 'holder', ARGV[2])
for i = 1, n do redis.call('HSET', KEYS[1], ARGV[6 + 2 * i], ARGV[7 + 2 * i]) end
local at = 8 + 2 * n
if ARGV[at] then redis.call('ZREMRANGEBYSCORE', KEYS[2], ARGV[at], '+inf') end
for i = at, #ARGV, 2 do redis.call('ZADD', KEYS[2], ARGV[i], ARGV[i + 1]) end
redis.call('ZREMRANGEBYSCORE', KEYS[2], '-inf', '(' .. ARGV[6])
redis.call('PEXPIRE', KEYS[1], ARGV[3])
redis.call('PEXPIRE', KEYS[2], ARGV[3])
redis.call('ZADD', KEYS[3], ARGV[4], ARGV[5])
return 1
"""

# Claims a session if its epoch is still the one that was seen. KEYS: session. ARGV: epoch seen, holder.
CLAIM = """
local seen = redis.call('HGET', KEYS[1], 'epoch')
if seen ~= ARGV[1] then return false end
local time = redis.call('TIME')
local epoch = math.max(tonumber(seen) + 1, tonumber(time[1]) * 1000000 + tonumber(time[2]))
local text = string.format('%.0f', epoch)
redis.call('HSET', KEYS[1], 'epoch', text, 'holder', ARGV[2], 'whole', '0')
return text
"""

# Gives up a claim, unless a later one exists. KEYS: session. ARGV: epoch.
RELEASE = """
if redis.call('HGET', KEYS[1], 'epoch') ~= ARGV[1] then return 0 end
redis.call('HSET', KEYS[1], 'holder', '')
return 1
"""

# Forgets a session that has ended, unless a later claim exists, and remembers how it ended.
# KEYS: session, its past, sessions of the owner. ARGV: epoch, owner, reason, detail, milliseconds to remember, id.
FORGET = """
local seen = redis.call('HGET', KEYS[1], 'epoch')
if seen and tonumber(seen) > tonumber(ARGV[1]) then return 0 end
redis.call('DEL', KEYS[1], KEYS[2])
redis.call('HSET', KEYS[1], 'epoch', ARGV[1], 'owner', ARGV[2], 'ended', ARGV[3], 'detail', ARGV[4])
redis.call('PEXPIRE', KEYS[1], ARGV[5])
redis.call('ZREM', KEYS[3], ARGV[6])
return 1
"""

# Takes a place among the sessions of an owner. KEYS: sessions of the owner.
# ARGV: now, instant when the place expires unless the session is saved, id, the most that the owner may have.
ADMIT = """
redis.call('ZREMRANGEBYSCORE', KEYS[1], '-inf', ARGV[1])
if redis.call('ZCARD', KEYS[1]) >= tonumber(ARGV[4]) then return 0 end
redis.call('ZADD', KEYS[1], ARGV[2], ARGV[3])
return 1
"""

# Renews the lease of a node, and returns the incarnation and the number of the beat that were there before.
# KEYS: node, all nodes. ARGV: name, incarnation, beat, milliseconds of the lease, now, then names and values of fields.
BEAT = """
local before = redis.call('HMGET', KEYS[1], 'incarnation', 'beat')
if before[1] and before[1] ~= ARGV[2] and ARGV[3] ~= '0' then return before end
redis.call('HSET', KEYS[1], 'incarnation', ARGV[2], 'beat', ARGV[3], unpack(ARGV, 6))
redis.call('PEXPIRE', KEYS[1], ARGV[4])
redis.call('ZADD', KEYS[2], ARGV[5], ARGV[1])
return before
"""
