/* Stand-ins for the types of ARGoS3 that c_ref/examples/argos3 uses, with the same names and signatures. They
 * do what the example needs, so that its robots run; run_swarm.cpp is the simulator around them. */
#ifndef ARGOS_STUB_H
#define ARGOS_STUB_H

#include <any>
#include <cmath>
#include <cstdint>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <random>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace argos
{
using Real = double;
using UInt8 = uint8_t;
using UInt32 = uint32_t;
using UInt64 = uint64_t;
using SInt64 = int64_t;

#define LOG std::cout

/* --- Errors ------------------------------------------------------------------------------------------ */

struct CARGoSException : std::runtime_error {
    using std::runtime_error::runtime_error;
};

/* Like ARGoS's, it finds the exception's name where its user does. */
#define THROW_ARGOSEXCEPTION(message)                                                                        \
    {                                                                                                        \
        std::ostringstream exception_text;                                                                   \
        exception_text << message;                                                                           \
        throw CARGoSException(exception_text.str());                                                         \
    }

#define THROW_ARGOSEXCEPTION_NESTED(message, nested) THROW_ARGOSEXCEPTION(message << ": " << (nested).what())

/* --- Configuration ----------------------------------------------------------------------------------- */

/* The attributes of an XML element. */
using TConfigurationNode = std::map<std::string, std::string>;

template <typename T> void GetNodeAttribute(TConfigurationNode &node, const std::string &name, T &value)
{
    if (node.find(name) == node.end()) {
        THROW_ARGOSEXCEPTION("attribute \"" << name << "\" is missing");
    }
    std::istringstream text(node[name]);
    if (!(text >> value)) {
        THROW_ARGOSEXCEPTION("attribute \"" << name << "\" has no such value");
    }
}

template <typename T>
void GetNodeAttributeOrDefault(TConfigurationNode &node, const std::string &name, T &value,
                               const T &default_value)
{
    if (node.find(name) != node.end()) {
        GetNodeAttribute(node, name, value);
    } else {
        value = default_value;
    }
}

/* --- Mathematics ------------------------------------------------------------------------------------- */

struct CRadians {
    static const CRadians ZERO;
    CRadians() = default;
    explicit CRadians(Real radians) : value(radians) {}
    CRadians operator-(const CRadians &other) const { return CRadians(value - other.value); }
    Real operator/(const CRadians &other) const { return value / other.value; }
    bool operator<(const CRadians &other) const { return value < other.value; }
    bool operator>(const CRadians &other) const { return value > other.value; }
    Real value = 0.0;
};
inline const CRadians CRadians::ZERO;

struct CDegrees {
    explicit CDegrees(Real degrees) : value(degrees) {}
    Real value;
};

inline CRadians ToRadians(const CDegrees &angle) { return CRadians(angle.value * M_PI / 180.0); }
inline CRadians Abs(const CRadians &angle) { return CRadians(std::abs(angle.value)); }

struct CVector2 {
    CVector2() = default;
    CVector2(Real first, Real second) : x(first), y(second) {}
    CVector2(Real length, const CRadians &angle)
        : x(length * std::cos(angle.value)), y(length * std::sin(angle.value))
    {
    }
    Real GetX() const { return x; }
    Real GetY() const { return y; }
    Real Length() const { return std::hypot(x, y); }
    CRadians Angle() const { return CRadians(std::atan2(y, x)); }
    CVector2 operator-() const { return CVector2(-x, -y); }
    CVector2 &operator+=(const CVector2 &other) { return *this = CVector2(x + other.x, y + other.y); }
    Real x = 0.0;
    Real y = 0.0;
};

template <typename T> struct CRange {
    CRange(const T &least, const T &largest) : minimum(least), maximum(largest) {}
    T minimum;
    T maximum;
};

struct CRandom {
    struct CRNG {
        Real Uniform(const CRange<Real> &range)
        {
            return std::uniform_real_distribution<Real>(range.minimum, range.maximum)(engine);
        }
        std::mt19937_64 engine{1};
    };

    /* All robots draw from one generator, as in ARGoS. */
    static CRNG *CreateRNG(const std::string &)
    {
        static CRNG generator;
        return &generator;
    }
};

/* --- Data -------------------------------------------------------------------------------------------- */

class CByteArray
{
  public:
    CByteArray() = default;
    explicit CByteArray(size_t size, UInt8 value = 0) : bytes_(size, value) {}
    size_t Size() const { return bytes_.size(); }
    UInt8 &operator[](size_t index) { return bytes_.at(index); }
    UInt8 operator[](size_t index) const { return bytes_.at(index); }

  private:
    std::vector<UInt8> bytes_;
};

struct CColor {
    int gray;
    static const CColor BLACK;
    static const CColor WHITE;
};
inline const CColor CColor::BLACK{0};
inline const CColor CColor::WHITE{255};

struct CAny {
    std::any content;
};
template <typename T> T &any_cast(CAny &any) { return std::any_cast<T &>(any.content); }

/* --- Sensors and actuators --------------------------------------------------------------------------- */

/* A device whose readings the simulator sets. */
template <typename Reading> struct StubSensor {
    using TReadings = std::vector<Reading>;
    const TReadings &GetReadings() const { return readings; }
    TReadings readings;
};

struct SProximityReading {
    Real Value;
    CRadians Angle;
};
using CCI_KheperaIVProximitySensor = StubSensor<SProximityReading>;

struct SGroundReading {
    Real Value;
    CVector2 Offset;
};
using CCI_KheperaIVGroundSensor = StubSensor<SGroundReading>;

struct SPacket {
    Real Range;
    CRadians HorizontalBearing;
    CRadians VerticalBearing;
    CByteArray Data;
};
using CCI_RangeAndBearingSensor = StubSensor<SPacket>;

struct CCI_RangeAndBearingActuator {
    void SetData(const CByteArray &new_data)
    {
        if (new_data.Size() != data.Size()) {
            THROW_ARGOSEXCEPTION("data size does not match, expected " << data.Size() << ", got "
                                                                       << new_data.Size());
        }
        data = new_data;
    }
    CByteArray data;
};

struct CCI_DifferentialSteeringActuator {
    void SetLinearVelocity(Real left_speed, Real right_speed)
    {
        left = left_speed;
        right = right_speed;
    }
    Real left = 0.0;
    Real right = 0.0;
};

/* --- Controllers ------------------------------------------------------------------------------------- */

struct CCI_Controller {
    virtual ~CCI_Controller() = default;
    virtual void Init(TConfigurationNode &) {}
    virtual void ControlStep() {}
    virtual void Reset() {}
    virtual void Destroy() {}

    const std::string &GetId() const { return id; }
    template <typename Actuator> Actuator *GetActuator(const std::string &type)
    {
        return std::any_cast<Actuator *>(devices.at(type + " actuator"));
    }
    template <typename Sensor> Sensor *GetSensor(const std::string &type)
    {
        return std::any_cast<Sensor *>(devices.at(type + " sensor"));
    }

    std::string id;
    std::map<std::string, std::any> devices;
};

struct CControllableEntity {
    CCI_Controller &GetController() { return *controller; }
    std::unique_ptr<CCI_Controller> controller;
};

/* --- Simulator --------------------------------------------------------------------------------------- */

struct CSpace {
    using TMapPerType = std::map<std::string, CAny>;
    TMapPerType &GetEntitiesByType(const std::string &type) { return entities.at(type); }
    UInt32 GetSimulationClock() const { return clock; }

    std::map<std::string, TMapPerType> entities;
    UInt32 clock = 0;
};

struct CSimulator {
    static CSimulator &GetInstance()
    {
        static CSimulator simulator;
        return simulator;
    }
    UInt32 GetRandomSeed() const { return random_seed; }
    UInt32 GetMaxSimulationClock() const { return max_clock; }
    CSpace &GetSpace() { return space; }

    UInt32 random_seed = 1;
    UInt32 max_clock = 0;
    CSpace space;
};

struct CLoopFunctions {
    virtual ~CLoopFunctions() = default;
    virtual void Init(TConfigurationNode &) {}
    virtual void Reset() {}
    virtual void Destroy() {}
    virtual void PreStep() {}
    virtual void PostStep() {}
    virtual void PostExperiment() {}
    virtual CColor GetFloorColor(const CVector2 &) { return CColor::WHITE; }
    CSimulator &GetSimulator() { return CSimulator::GetInstance(); }
    CSpace &GetSpace() { return CSimulator::GetInstance().GetSpace(); }
};

/* --- Registration ------------------------------------------------------------------------------------ */

/* Makers of controllers and loop functions by their label in the configuration. */
template <typename Base> std::map<std::string, std::function<Base *()>> &Makers()
{
    static std::map<std::string, std::function<Base *()>> makers;
    return makers;
}

#define REGISTER_CONTROLLER(class_name, label)                                                               \
    static const bool is_registered =                                                                        \
        argos::Makers<argos::CCI_Controller>().emplace(label, [] { return new class_name; }).second;
#define REGISTER_LOOP_FUNCTIONS(class_name, label)                                                           \
    static const bool is_registered =                                                                        \
        argos::Makers<argos::CLoopFunctions>().emplace(label, [] { return new class_name; }).second;
} // namespace argos

#endif
