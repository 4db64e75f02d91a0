// The JSON of a frame header, byte by byte as the other clients write it.

import Foundation

/// The canonical JSON of a header, the same in all clients: sorted keys, no spaces, no nil fields, whole numbers
/// without a decimal point. Words are the raw values of the enums above; none of them needs an escape.
enum WireJSON {
    case word(String)
    case whole(Int)
    case number(Double)
    case truth(Bool)
    case list([WireJSON])
    case object([String: WireJSON?])

    func written() throws -> String {
        switch self {
        case .word(let word):
            return "\"\(word)\""
        case .whole(let value):
            return String(value)
        case .number(let value):
            guard value.isFinite else {
                throw RoomLightRefusal(field: "header", rule: "numbers must be finite, got \(value)")
            }
            if value == value.rounded() && abs(value) < 9_007_199_254_740_992 {
                return String(Int64(value))
            }
            return "\(value)" // the shortest form, with an exponent below 0.0001: 1.5e-05
        case .truth(let value):
            return value ? "true" : "false"
        case .list(let items):
            return "[" + (try items.map { try $0.written() }).joined(separator: ",") + "]"
        case .object(let fields):
            var pairs: [String] = []
            for key in fields.keys.sorted() {
                if let found = fields[key], let value = found {
                    pairs.append("\"\(key)\":" + (try value.written()))
                }
            }
            return "{" + pairs.joined(separator: ",") + "}"
        }
    }
}
