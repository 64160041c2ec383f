import java.awt.image.BufferedImage
import java.io.ByteArrayInputStream
import java.io.ByteArrayOutputStream
import java.io.File
import java.net.HttpURLConnection
import java.net.URL
import java.util.concurrent.LinkedBlockingQueue
import java.util.concurrent.TimeUnit
import javax.imageio.ImageIO
import kotlin.system.exitProcess
import org.json.JSONObject

/** SERVICE KEY x,y,w,h whole|regions FRAME...: a line a frame, in step with the tracker. */
fun main(args: Array<String>) {
    val (service, key, box, how) = args
    val frames = args.drop(4).map { File(it).readBytes() }
    val id = createSession(service, key, frames[0], listOf(box.split(",").map { it.toDouble() }))
    val results = LinkedBlockingQueue<String>()
    val ticket = {
        val call = URL("$service/v1/sessions/$id/ticket").openConnection() as HttpURLConnection
        call.requestMethod = "POST"
        call.setRequestProperty("Authorization", "Bearer $key")
        JSONObject(call.inputStream.reader().readText()).getString("ticket")
    }
    val stream = TrackingStream(service, id, { if (key == "") null else ticket() }, { seq, targets ->
        results.add("$seq " + targets[0].id + " " + targets[0].box.joinToString(",") + " " + targets[0].status)
    }, { reason -> results.add("ended $reason") })
    stream.open()
    var cuts = 0
    for (frame in frames.drop(1)) {
        var result: String? = null
        while (result == null) {
            val region = if (how == "regions") stream.region else null
            val image = if (region == null) frame else cut(frame, region)
            val sent = stream.send(image, region)
            if (sent && region != null) cuts += 1
            // Refused or lost with its connection: once more.
            result = results.poll(if (sent) 3000 else 10, TimeUnit.MILLISECONDS)
        }
        println(result)
    }
    println("cuts $cuts")
    val call = URL("$service/v1/sessions/$id").openConnection() as HttpURLConnection
    call.requestMethod = "DELETE"
    call.setRequestProperty("Authorization", "Bearer $key")
    check(call.responseCode == 204)
    println(results.poll(20, TimeUnit.SECONDS))
    exitProcess(0)
}

fun cut(jpeg: ByteArray, region: List<Int>): ByteArray {
    val image: BufferedImage = ImageIO.read(ByteArrayInputStream(jpeg))
    val (x, y, w, h) = region
    val out = ByteArrayOutputStream()
    ImageIO.write(image.getSubimage(x, y, w, h), "png", out)
    return out.toByteArray()
}
